"""Frames of different brightness, with stripes that the camera hardly resolves: no pixel becomes wrong."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.numerics import Image
from scanner.decoding import MaskReason
from scanner.decoding.corrections.gains import BitLevels, gains_of_stripes, levels_of_bit, white_of
from scanner.patterns import PRESETS, PresetName, sequence_for
from tests.support.findings import kinds_of
from tests.support.synthetic_capture import Scene, decode

PIXELS = 4096


def fine_stripes(contrast: float, seed: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return a pattern and its inverse (2, P) in the same light, and the five coarser bits: 32 cells, each half lit."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0, 32, PIXELS)
    light = 100 * rng.uniform(0.5, 1.5, PIXELS) * np.exp(0.3 * np.sin(place / 5))
    side = np.where((place + 0.5) % 2 < 1, 0.5, -0.5) * contrast
    levels = light * np.exp([side, -side]) + rng.normal(0, 1, (2, PIXELS))
    number = place.astype(np.int64)
    return levels.astype(np.float32), [(number ^ number >> 1) >> bit & 1 == 1 for bit in range(4, -1, -1)]


@given(st.floats(-1.2, 1.2), st.floats(0.05, 1.2), st.integers(0, 1000))
def test_the_ratio_of_two_exposures_is_found_at_any_contrast(log_ratio: float, contrast: float, seed: int) -> None:
    levels, coarser = fine_stripes(contrast, seed)
    levels[0] *= np.exp(log_ratio)
    gains = gains_of_stripes(levels, coarser)
    within = 0.02 + 0.15 * contrast
    if gains is None:
        assert abs(log_ratio) < 2 * within, "told where it matters"
    else:
        assert np.log(gains.of_rows[0, 0] / gains.of_rows[1, 0]) == pytest.approx(log_ratio, abs=within)


def test_bits_that_light_one_side_only_are_no_difference_in_brightness() -> None:
    levels, coarser = fine_stripes(0.0, 1)
    levels[1] *= 0.2
    assert gains_of_stripes(levels, []) is None, "a bit that is the same everywhere"
    assert gains_of_stripes(levels, coarser[:2]) is None, "four cells do not tell"
    halves = np.where(coarser[0], levels, levels[::-1])
    assert gains_of_stripes(halves, coarser) is None, "a bit that is one of the coarser ones"


@pytest.mark.parametrize("with_white", [True, False])
def test_an_exposure_that_changes_threefold_costs_few_pixels(with_white: bool) -> None:
    scene = replace(Scene(), exposure=110.0, projector=(440, 300), camera_blur_px=0.9)
    patterns = sequence_for(scene.projector, cell=1, shifts=0)
    patterns = patterns if with_white else patterns[2:]
    frames = scene.frames(patterns)
    by = np.exp(np.random.default_rng(4).uniform(-0.55, 0.55, len(frames)))
    changed = [np.clip(np.rint(frame * g), 0, 255).astype(np.uint8) for frame, g in zip(frames, by, strict=True)]
    lit = scene.well_lit()
    steady, auto = (decode(patterns, each, scene.projector) for each in (frames, changed))
    kept = [float(np.mean(decoding.reasons[lit] == MaskReason.KEPT)) for decoding in (steady, auto)]
    assert 0.9 < kept[0] <= 1
    assert kept[1] > 0.85 * kept[0]
    errors = np.linalg.norm(scene.errors(auto), axis=1)
    assert 0.02 < np.median(errors) < 0.2
    assert np.mean(errors < 1) > 0.99


SCENE = Scene(camera=(240, 180), projector=(427, 280), indirect=0.5)
# White, coarse and finest bits, the base of the XOR code and a bit relative to it, steps of the last fringe.
CASES: list[tuple[PresetName, int, float]] = [
    *(("quick", number, 0.6) for number in (7, 8, 13)),
    ("quick", 0, 1.4),
    *(("standard", number, factor) for number in (34, 41) for factor in (0.6, 1.4)),
    *(("concave", number, 0.6) for number in (7, 18)),
    *(("concave", number, 1.4) for number in (8, 22)),
]


@pytest.mark.parametrize(("preset", "number", "factor"), CASES)
def test_one_brighter_frame_causes_no_wrong_matches(preset: PresetName, number: int, factor: float) -> None:
    patterns = PRESETS[preset].patterns(SCENE.projector)
    frames = SCENE.frames(patterns)
    frames[number] = np.rint(np.clip(factor * frames[number].astype(float), 0, 255)).astype(np.uint8)
    decoding = decode(patterns, frames, SCENE.projector)
    errors = np.abs(SCENE.errors(decoding)).max(axis=1)
    assert 0.01 < np.median(errors) < 0.06
    assert np.mean(errors > 1) < 1e-3
    assert np.mean(decoding.reasons[SCENE.well_lit()] == MaskReason.KEPT) > 0.97
    assert ("brighter-white" in kinds_of(decoding.findings)) == (number == 0)


def frame_of_bit(gain: float, dark: float, bright: float, ambient: float) -> tuple[Image, Image, Image, np.ndarray]:
    """Return a bit's frame of 60 × 80 pixels, the half-way level, white, and which pixels are lit."""
    rng = np.random.default_rng(3)
    black = ambient * rng.uniform(0.8, 1.2, (60, 80))
    swing = 100 * rng.uniform(0.4, 1.0, (60, 80))
    lit = rng.random((60, 80)) < 0.3
    seen = gain * (black + np.where(lit, bright, dark) * swing) + rng.normal(0, 0.7, (60, 80))
    frame, middle, white = (
        np.rint(np.clip(level, 0, 255)).astype(np.uint8) for level in (seen, black + swing / 2, black + swing)
    )
    return frame, middle, white, lit


@given(gain=st.floats(0.5, 1.6), dark=st.floats(0, 0.2), bright=st.floats(0.6, 1), ambient=st.floats(0, 60))
def test_bits_are_thresholded_between_their_own_two_levels(
    gain: float, dark: float, bright: float, ambient: float
) -> None:
    frame, middle, white, lit = frame_of_bit(gain, dark, bright, ambient)
    levels = levels_of_bit(frame.ravel(), middle.ravel(), white.ravel())
    assert levels is not None
    assert np.mean((frame > levels.threshold(middle, white)) == lit) > 0.999
    assert levels.bright - levels.dark == pytest.approx(gain * (bright - dark), abs=0.03)


def test_a_uniform_frame_has_no_bit_levels() -> None:
    frame, middle, white, _ = frame_of_bit(1.0, 0.5, 0.5, 10.0)
    assert levels_of_bit(frame.ravel(), middle.ravel(), white.ravel()) is None


@pytest.mark.parametrize(
    ("dark", "bright", "white"),
    [
        (0.0, 1.0, 1.0),
        (0.2, 0.8, 1.0),  # bounced light
        (0.0, 0.7, 0.7),  # a white frame that was exposed longer
        (0.2, 1.4, 1.6),  # a darker one, and bounced light
        (0.1, 1.1, 1.0),  # light that was switched on after it
        (-0.1, 0.9, 1.0),  # … off
    ],
)
def test_a_brighter_white_is_distinguished_from_other_light(dark: float, bright: float, white: float) -> None:
    bits = [BitLevels(1.0, dark + off, bright - off, 0.0) for off in (-0.01, 0.0, 0.0, 0.02)]
    assert white_of(bits) == pytest.approx(white, abs=0.03)
