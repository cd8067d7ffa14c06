"""The benchmark of conditions judges captures with known outcomes correctly."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conditions.captures import SEQUENCES, Capture, blended, inverses, patterns_of
from conditions.catalogue import conditions
from conditions.judging import (
    Truth,
    calibration_error,
    could_be_decoded,
    match_errors,
    matched_share,
)
from conditions.plain_decoder import plain_matches
from conditions.table import BEGIN, END, confident_and_wrong, markdown, refused_needlessly, write_into
from conditions.trial import Outcome, Setup, captured, named, run

from calib.geometry import Calibration, DeviceSigmas, Matches, Sigmas
from scanner.decoding import Decoder
from scanner.patterns import Gray, Phase, draw

pytestmark = pytest.mark.xdist_group("conditions")  # what the module shares is made once

PROJECTOR = (214, 120)
SETUP = Setup(0, "standard", (306, 256), PROJECTOR)
FOUND = Outcome("nothing", "", 0, "standard", 0, "", "good", 0.99, 0.03, 0.1, (0.1, -0.2, 0.0, 0.3), (1, -2, 0, 3))
REFUSED = Outcome("flicker", "5 %", 0, "standard", 2, "refused", decodable=True)


@pytest.fixture(scope="module")
def undisturbed() -> tuple[Capture, Truth]:
    return captured(named("nothing", ""), SETUP)


def changed(calibration: Calibration, percent: float, sigma: Sigmas) -> Calibration:
    projector = calibration.projector
    x, y = (f * (1 + percent / 100) for f in projector.focal_px)
    longer = replace(projector, focal_px=(x, y))
    return replace(calibration, projector=longer, sigma=sigma)


SIGMA = Sigmas(DeviceSigmas((1.0, 1.0)), DeviceSigmas((3.0, 3.0), (0.5, 0.5)))


@pytest.mark.parametrize(
    ("percent", "sigma", "wrong", "useful"),
    [
        (1.0, SIGMA, False, True),  # 3.1 of 312 px, as much as sigma
        (3.0, SIGMA, True, True),  # 3.1 sigma, but more than 2 %
        (1.9, Sigmas(SIGMA.camera, DeviceSigmas((1.0, 1.0), (0.5, 0.5))), True, True),  # 5.9 sigma, but less than 2 %
        (5.0, SIGMA, True, False),
        (0.1, Sigmas(), True, True),  # a calibration that states no sigma
    ],
)
def test_limits_of_wrong_and_useful_results(
    undisturbed: tuple[Capture, Truth], percent: float, sigma: Sigmas, wrong: bool, useful: bool
) -> None:
    truth = undisturbed[1]
    error = calibration_error(changed(truth.calibration, percent, sigma), truth)
    assert error.percent[1] == pytest.approx(percent)
    if stated := sigma.projector.focal_px:
        expected = percent / 100 * truth.calibration.projector.focal_px[0] / stated[0]
        assert error.sigmas[1] == pytest.approx(expected)
    assert (error.is_wrong, error.is_useful) == (wrong, useful)


def test_without_a_pinhole_projector_only_the_camera_is_judged(undisturbed: tuple[Capture, Truth]) -> None:
    truth = replace(undisturbed[1], pinhole=False)
    error = calibration_error(changed(truth.calibration, 20.0, SIGMA), truth)
    assert error.percent.tolist() == [0.0]
    assert not error.is_wrong


def test_matches_are_compared_with_the_true_projector_pixels(undisturbed: tuple[Capture, Truth]) -> None:
    truth = undisturbed[1]
    y, x = (places[::7] for places in np.nonzero(truth.lit))
    right = Matches(np.stack([x, y], axis=1).astype(float), truth.projector_px[y, x].astype(float))
    np.testing.assert_allclose(match_errors(right, truth), 0, atol=1e-5)
    off = Matches(right.camera_px, right.projector_px + np.array([0.3, -0.4]))
    np.testing.assert_allclose(match_errors(off, truth), 0.5, atol=1e-4)
    half = right.camera_px[:, 0] < np.median(x)
    assert 0 < matched_share(Matches(right.camera_px[half], right.projector_px[half]), truth) < 0.75


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_the_plain_decoder_reads_every_sequence(undisturbed: tuple[Capture, Truth], sequence: str) -> None:
    """The camera sees the projector's pixels exactly: its own pictures are the frames."""
    patterns = patterns_of(sequence, PROJECTOR)
    found = plain_matches(patterns, [draw(pattern, PROJECTOR) for pattern in patterns])
    assert len(found) == PROJECTOR[0] * PROJECTOR[1]
    error = np.abs(found.projector_px - found.camera_px)
    assert error.max() < 0.02  # 8-bit levels of fringes


def test_a_gray_code_without_its_finest_bits_gives_cell_centres() -> None:
    patterns = patterns_of("gray", PROJECTOR)
    found = plain_matches(patterns, [draw(pattern, PROJECTOR) for pattern in patterns], without_bits=2)
    assert len(found) == 54 * 30
    whole = found.projector_px[:, 0] < 212
    np.testing.assert_allclose(found.projector_px[whole], found.camera_px[whole])


def test_an_undisturbed_capture_is_decodable_and_one_with_an_inverted_bit_is_not(
    undisturbed: tuple[Capture, Truth],
) -> None:
    capture, truth = undisturbed
    assert could_be_decoded([plain_matches(capture.patterns, capture.frames)], truth)
    coarse = next(i for i, p in enumerate(capture.patterns) if isinstance(p, Gray) and (p.axis, p.bit) == ("y", 1))
    turned = capture.replaced({coarse: capture.frames[coarse + 1], coarse + 1: capture.frames[coarse]})
    assert not could_be_decoded([plain_matches(turned.patterns, turned.frames)], truth)


def test_a_locally_disturbed_capture_is_decodable(undisturbed: tuple[Capture, Truth]) -> None:
    capture, truth = undisturbed
    matches = plain_matches(capture.patterns, capture.frames)
    passed = matches.camera_px[:, 0] < np.quantile(matches.camera_px[:, 0], 0.2)
    moved = matches.projector_px + np.where(passed, 40.0, 0.0)[:, None] * np.array([1.0, -0.5])
    assert could_be_decoded([Matches(matches.camera_px, moved)], truth)
    assert not could_be_decoded([Matches(matches.camera_px, matches.projector_px[:, ::-1])], truth)


def test_totals_count_only_decodable_captures_without_mistakes() -> None:
    fault = next(condition for condition in conditions() if condition.fault)
    outcomes = [
        FOUND,
        REFUSED,
        replace(REFUSED, decodable=False),
        replace(REFUSED, name=fault.name, strength=fault.strength),
        replace(FOUND, wrong=True, grade="fair"),
        replace(FOUND, name="projector bumped between the axes", strength="1 px", wrong=True),
    ]
    assert refused_needlessly(outcomes) == [REFUSED]
    assert confident_and_wrong(outcomes) == outcomes[-1:]
    text = markdown(outcomes)
    assert "Devices at rest, 5 captures: **1 refused that could be decoded, 0 confident and wrong**; 1 more" in text
    assert "Devices that move, 1 captures: **0 refused that could be decoded, 1 confident and wrong**; 0 more" in text
    assert "| flicker | 5 % | 2 | – | – | – | – | – | 1 | – |" in text
    assert "| nothing |  | 0 | 99.0% | 0.03, 0.10 | 0.19, 0.30 | 1.9, 3.0 | fair × 1, good × 1 | – | – |" in text


def test_a_table_replaces_the_one_before_it(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_into(page, "new")
    assert page.read_text() == f"before\n{BEGIN}\nnew\n{END}\nafter\n"


def test_every_condition_applies_to_every_sequence_and_has_a_unique_name() -> None:
    rng = np.random.default_rng(0)
    names = [(condition.name, condition.strength) for condition in conditions()]
    assert len(set(names)) == len(names) > 80
    for condition in conditions():
        for sequence in SEQUENCES:
            patterns = patterns_of(sequence, PROJECTOR)
            settings = condition.settings(patterns, rng)
            frames = [part["frame"] for part in settings.values() if isinstance(part, dict) and "frame" in part]
            assert all(2 <= frame < len(patterns) for frame in frames), condition


def test_the_stated_share_of_lit_pixels_saturates(undisturbed: tuple[Capture, Truth]) -> None:
    saturated, truth = captured(named("saturated in white", "30 % of lit pixels"), SETUP)
    assert 0.2 < np.mean(saturated.frames[0][truth.lit] == 255) < 0.4
    assert np.mean(undisturbed[0].frames[0][truth.lit] == 255) < 0.01


def test_mistakes_with_frames_change_only_frames(undisturbed: tuple[Capture, Truth]) -> None:
    capture, rng = undisturbed[0], np.random.default_rng(0)
    for name, changed_frames in (("two frames exchanged", 2), ("one frame repeated", 1)):
        after = named(name, "").frames(capture, rng)
        assert sum(a is not b for a, b in zip(after.frames, capture.frames, strict=True)) == changed_frames
        assert (after.patterns, after.projector_size) == (capture.patterns, capture.projector_size)
    dark, bright = np.zeros((2, 2), np.uint8), np.full((2, 2), 200, np.uint8)
    assert blended(dark, bright, 0.25).tolist() == [[50, 50], [50, 50]]
    for shown, inverse in inverses(capture.patterns):
        bit = capture.patterns[shown]
        assert isinstance(bit, Gray)
        assert replace(bit, inverted=True) == capture.patterns[inverse]
    assert not any(isinstance(capture.patterns[shown], Phase) for shown, _ in inverses(capture.patterns))


@pytest.mark.parametrize("sequence", ["quick", "standard"])
def test_stray_light_above_the_noise_of_a_12_bit_camera_is_not_decoded(sequence: str) -> None:
    """Stray light comes from other surfaces, with other bits, a hundredth as bright, and above the noise."""
    condition = named("camera of 12 bits", "20 × as many electrons")
    capture, truth = captured(condition, replace(SETUP, sequence=sequence))
    decoder = Decoder(capture.patterns, capture.projector_size)
    for frame in capture.frames:
        decoder.add(frame)
    matches = decoder.finish().matches
    assert matched_share(matches, truth) > 0.97
    assert 0.005 < np.median(match_errors(matches, truth)) < 0.1


def test_exposure_changes_that_look_like_switched_light_decode() -> None:
    """Plain Gray code, each frame exposed differently: removing the apparent light change would break the code."""
    outcome = run(named("each frame exposed differently", "up to × 3"), replace(SETUP, sequence="gray"))
    assert outcome.exit_code == 0, outcome.message
    assert outcome.match_median_px is not None
    assert 0.01 < outcome.match_median_px < 0.2
    assert not confident_and_wrong([outcome])
