"""An object moves in a part of the picture during a capture: that part is masked, and the rest is correct."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.numerics import Bools, Floats, Image
from scanner.decoding import Decoding, GridSample, MaskReason, plan_sequence
from scanner.decoding.light import NoiseModel, find_violations
from scanner.decoding.motion import InconsistentPixels, find_inconsistent_pixels
from scanner.errors import InputError
from scanner.patterns import PRESETS, Pattern, Phase, PresetName, sequence_for
from tests.support.findings import kinds_of, the_only
from tests.support.synthetic_capture import Scene, decode

SCENE = Scene()
STANDARD = sequence_for(SCENE.projector)
# Another surface, twice as bright: a passing person is closer to the projector.
OTHER = replace(SCENE, turn_deg=-20.0, zoom=0.6, exposure=400.0, seed=2)
# The same scene in a shadow.
SHADED = replace(SCENE, exposure=0.1 * SCENE.exposure)
# A part of the camera's 225 × 300 pixels.
PLACE = np.s_[60:190, 200:250]
EVERYWHERE = np.s_[:, :]


def with_passing_object(
    patterns: Sequence[Pattern], numbers: Sequence[int], place: tuple[slice, slice] = PLACE, other: Scene = OTHER
) -> list[Image]:
    """Return frames of which those in `numbers` show another scene at `place`."""
    frames = SCENE.frames(patterns)
    for number in numbers:
        frames[number] = frames[number].copy()
        frames[number][place] = other.frame(patterns[number], number)[place]
    return frames


def around_place(margin_px: int) -> Bools:
    """Return the mask (H, W) of the place, dilated by a margin."""
    chosen = np.zeros(SCENE.camera[::-1], np.bool_)
    rows, columns = PLACE
    chosen[rows.start - margin_px : rows.stop + margin_px, columns.start - margin_px : columns.stop + margin_px] = True
    return chosen


def of_fringes(patterns: Sequence[Pattern]) -> set[int]:
    """Return the numbers of the frames that show fringes."""
    return {number for number, pattern in enumerate(patterns) if isinstance(pattern, Phase)}


def wrong(decoding: Decoding) -> float:
    """Return the share of matches with an error above one pixel."""
    return float(np.mean(np.abs(SCENE.errors(decoding)).max(axis=1) > 1))


@pytest.mark.parametrize(
    ("preset", "first", "named"),
    [
        ("standard", 6, "gray x bit 2"),
        ("standard", 30, "phase"),
        ("concave", 28, "phase"),
        ("quick", 4, "gray x bit"),
        ("quick", 15, "phase"),
    ],
)
def test_a_passing_object_is_masked(preset: PresetName, first: int, named: str) -> None:
    patterns = PRESETS[preset].patterns(SCENE.projector)
    decoding = decode(patterns, with_passing_object(patterns, range(first, first + 4)), SCENE.projector)
    moved, kept, lit = decoding.reasons == MaskReason.MOVED, decoding.reasons == MaskReason.KEPT, SCENE.well_lit()
    assert np.mean(kept[lit & ~around_place(6)]) > 0.99
    assert np.mean(moved & ~around_place(6)) < 0.005, "the place has 0.1"
    if first in of_fringes(patterns):
        assert np.mean(moved[around_place(-4) & lit]) > 0.95
    else:
        assert 0.1 < np.mean(kept[around_place(-4) & lit]) < 0.9, "fringes tell where the codes were right"
    assert wrong(decoding) < 0.002
    assert named in the_only("moving-object", decoding.findings).message


def test_an_object_crossing_the_picture_is_masked_where_it_was_seen() -> None:
    """A third of the picture at a time: in one pair of bits, in another, and in some steps of a fringe."""
    frames, lit = SCENE.frames(STANDARD), SCENE.well_lit()
    columns = np.flatnonzero(lit.any(axis=0))
    edges = np.quantile(columns, [0.0, 0.31, 0.62, 0.93]).astype(int)
    for first, left, right in zip((20, 22, 28), edges, edges[1:], strict=False):
        place = np.s_[:, left:right]
        for number in range(first, first + 2):
            frames[number] = frames[number].copy()
            frames[number][place] = OTHER.frame(STANDARD[number], number)[place]
    decoding = decode(STANDARD, frames, SCENE.projector)
    kept = decoding.reasons == MaskReason.KEPT
    assert "moving-object" in kinds_of(decoding.findings)
    assert np.mean(kept[:, edges[3] + 6 :][lit[:, edges[3] + 6 :]]) > 0.95
    assert 0.3 < np.mean(kept[lit]) < 0.8
    assert wrong(decoding) < 0.005


def test_a_displaced_object_is_masked_at_its_old_and_new_place() -> None:
    frames = with_passing_object(STANDARD, range(30, len(STANDARD)), other=replace(SCENE, turn_deg=9.0))
    decoding = decode(STANDARD, frames, SCENE.projector)
    assert 0.5 < np.mean((decoding.reasons == MaskReason.MOVED)[around_place(-4)]) < 0.8, (
        "not all of what is there changed"
    )
    assert wrong(decoding) < 0.005


@pytest.mark.parametrize("first_from_end", [6, 10], ids=["only fine bits after it", "grid ones as well"])
def test_a_large_object_is_masked_in_codes_without_fringes(first_from_end: int) -> None:
    patterns = sequence_for(SCENE.projector, cell=2, shifts=0)
    large, lit = np.s_[20:205, 60:240], SCENE.well_lit()
    frames = with_passing_object(patterns, range(len(patterns) - first_from_end, len(patterns)), large)
    decoding = decode(patterns, frames, SCENE.projector)
    assert 0.3 < np.count_nonzero(lit[large]) / np.count_nonzero(lit) < 0.6
    assert np.mean((decoding.reasons == MaskReason.MOVED)[large][lit[large]]) > 0.95
    assert wrong(decoding) < 0.005


@pytest.mark.parametrize("of_coarse_bit", [4, 9])
def test_bits_in_a_shadow_are_decided_by_the_surface(of_coarse_bit: int) -> None:
    patterns = sequence_for(SCENE.projector, cell=2, shifts=0)
    large, lit = np.s_[20:205, 60:240], SCENE.well_lit()
    decoding = decode(patterns, with_passing_object(patterns, [of_coarse_bit], large, SHADED), SCENE.projector)
    assert 0.85 < np.mean((decoding.reasons == MaskReason.KEPT)[large][lit[large]]) < 0.99
    assert wrong(decoding) < 0.005


def test_a_shadow_in_the_longer_fringe_keeps_positions_of_the_shorter_one() -> None:
    decoding = decode(STANDARD, with_passing_object(STANDARD, range(26, 30), other=SHADED), SCENE.projector)
    assert 0.2 < np.mean((decoding.reasons == MaskReason.KEPT)[around_place(-4) & SCENE.well_lit()]) < 0.8
    assert wrong(decoding) < 0.002


def test_the_mask_of_a_hand_has_its_size() -> None:
    hand = np.s_[100:125, 210:235]
    decoding = decode(STANDARD, with_passing_object(STANDARD, range(28, 32), hand), SCENE.projector)
    moved = decoding.reasons == MaskReason.MOVED
    assert np.mean(moved[hand]) > 0.8
    assert 0.007 < np.mean(moved) < 0.011, "0.009 is the hand"
    assert wrong(decoding) < 0.0005


@pytest.mark.parametrize("number", [5, 17, 30])
def test_a_frame_of_another_scene_is_named_as_corrupted(number: int) -> None:
    """It contradicts the others all over the picture, so that it is named, whatever is masked."""
    frames = with_passing_object(STANDARD, [number], EVERYWHERE, replace(SCENE, turn_deg=90.0, zoom=0.5))
    try:
        decoding = decode(STANDARD, frames, SCENE.projector)
    except InputError as error:
        said = str(error)
    else:
        said = " ".join(map(str, decoding.findings))
        assert wrong(decoding) < 0.02
    assert f"frame {number} " in said


@pytest.mark.parametrize("preset", ["quick", "concave"])
@pytest.mark.parametrize(
    "scene",
    [SCENE, replace(SCENE, projector_blur_px=3.0), replace(SCENE, gamma=3.0), replace(SCENE, read_noise=6.0)],
    ids=["at rest", "blurred projector", "strong gamma", "noisy camera"],
)
def test_no_motion_is_found_at_rest(preset: PresetName, scene: Scene) -> None:
    try:
        decoding = scene.decode(PRESETS[preset].patterns(scene.projector))
    except InputError as error:
        assert "moved" not in str(error)  # noqa: PT017
        return
    assert not np.any(decoding.reasons == MaskReason.MOVED)


def test_flicker_is_measured_even_if_all_lit_pixels_seem_to_move(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As happens when a lamp is switched on that lights more than the projector does."""
    frames = SCENE.frames(STANDARD)
    lit = np.ptp(np.stack(frames), axis=0) > 25
    seeming = InconsistentPixels(lit, lit, ~lit, 0.9, (30, 31))
    monkeypatch.setattr("scanner.decoding.sample_analysis.find_inconsistent_pixels", lambda *_: seeming)
    flicker = decode(STANDARD, frames, SCENE.projector).flicker
    assert flicker is not None
    assert 0 <= flicker < 0.005


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("knocked_px", [6, 14])
def test_a_bumped_camera_is_not_taken_for_a_moving_object(preset: PresetName, knocked_px: int) -> None:
    patterns = PRESETS[preset].patterns(SCENE.projector)
    plan, grid = plan_sequence(patterns, SCENE.projector), GridSample(SCENE.camera[::-1])
    first = next(number for number, pattern in enumerate(patterns) if isinstance(pattern, Phase))
    frames = [
        np.roll(frame, knocked_px, axis=1) if number >= first else frame
        for number, frame in enumerate(SCENE.frames(patterns))
    ]
    for number in range(len(plan.patterns)):
        grid.add(plan, plan.shown.index(number), grid.of(frames[plan.shown.index(number)]))
    assert find_inconsistent_pixels(plan, grid, NoiseModel(at_black=1.0, gain=1 / 30)) is None


@pytest.mark.parametrize("preset", ["quick", "concave"])
@pytest.mark.parametrize("wall", [0.5, 0.8])
def test_a_tone_curve_is_no_motion(preset: PresetName, wall: float) -> None:
    """Blurred fringes through a photograph's steep curve, and an object that is half as bright during some of them.

    Half of the pixels see a `wall` of this albedo, the others all kinds of albedo.
    """
    rng, size = np.random.default_rng(3), (300, 200)
    patterns = PRESETS[preset].patterns(size)
    albedo, *place = (rng.uniform(low, high, 3000) for low, high in ((0.15, 0.8), (0, size[0]), (0, size[1])))
    albedo[::2] = wall
    light = np.stack([pattern.brightness(*place) for pattern in patterns])
    fringes = np.array(sorted(of_fringes(patterns)))
    light[fringes] = 0.5 + 0.2 * (light[fringes] - 0.5)
    light = albedo * (0.9 * light + 0.05)
    moved = np.arange(len(albedo)) % 10 == 0
    light[np.ix_(fringes[:8], np.flatnonzero(moved))] *= 0.5
    level = steep(light ** (1 / 2.2))
    level = (level + steep(level)) / 2
    levels = (255 * level + rng.normal(0, 0.7, level.shape)).astype(np.float32)
    found = find_violations(plan_sequence(patterns, size), levels, NoiseModel(0.5, 0.0))
    flagged = np.any([each for _, each in found], axis=0)
    assert np.mean(flagged[~moved]) < 0.02
    assert np.mean(flagged[moved]) > 0.8


def steep(level: Floats) -> Floats:
    return level**2 * (3 - 2 * level)
