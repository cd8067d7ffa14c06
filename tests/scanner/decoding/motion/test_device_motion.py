"""Motion during a capture of a synthetic scene: the projector's picture moves by a known number of pixels."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from calib.numerics import Image
from calib.refusal import RefusalError
from scanner.decoding import Decoding
from scanner.decoding.motion import MotionCourse, MotionEstimate, MotionVerdict
from scanner.errors import InputError
from scanner.patterns import PRESETS, Gray, Pattern, Phase, PresetName, phase_sequence, sequence_for
from tests.support.synthetic_capture import Light, Scene, Turned, decode

SCENE = Scene()
STANDARD = sequence_for(SCENE.projector)
# The order of other programs: all patterns along x, then all along y.
APART = tuple(sorted(STANDARD, key=lambda pattern: getattr(pattern, "axis", "")))


@dataclass(frozen=True)
class Moved(Scene):
    """Return the scene after the projector's picture has moved."""

    right_px: float = 0.0
    down_px: float = 0.0

    def _plane(self, u: Light, v: Light, shift: float, tilt: float) -> tuple[Light, Light]:
        x, y = super()._plane(u, v, shift, tilt)
        return x - self.right_px, y - self.down_px


def frames(patterns: tuple[Pattern, ...], moved_px: Callable[[int], tuple[float, float]]) -> list[Image]:
    return [
        Moved(SCENE.camera, SCENE.projector, right_px=moved_px(number)[0], down_px=moved_px(number)[1]).frame(
            pattern, number
        )
        for number, pattern in enumerate(patterns)
    ]


def bumped(patterns: tuple[Pattern, ...], at: int, right_px: float, down_px: float = 0.0) -> Decoding:
    moved = frames(patterns, lambda number: (right_px, down_px) if number >= at else (0.0, 0.0))
    return decode(patterns, moved, SCENE.projector)


def found(decoding: Decoding) -> MotionEstimate:
    assert decoding.motion is not None
    return decoding.motion


@pytest.mark.parametrize("preset", PRESETS)
def test_no_motion_is_found_at_rest(preset: PresetName) -> None:
    motion = found(SCENE.decode(PRESETS[preset].patterns(SCENE.projector)))
    assert motion.verdict is MotionVerdict.NONE
    assert motion.unseen == ()
    assert motion.shifts.likely == ()


@pytest.mark.parametrize(("px", "before_the_end"), [(0.1, 8), (0.1, 5), (0.3, 3), (0.3, 10)])
def test_a_bump_among_the_fringes(px: float, before_the_end: int) -> None:
    at = len(STANDARD) - before_the_end
    motion = found(bumped(STANDARD, at, px, px))
    assert motion.is_significant
    assert motion.course is MotionCourse.BUMP
    assert motion.first < at <= motion.last
    assert 0.7 * px < motion.size_px / np.sqrt(2) < 1.3 * px
    assert str(motion).startswith("the projector")


def test_a_drift_does_not_shift_the_axes_against_each_other() -> None:
    total_px, count = 1.0, len(STANDARD)
    decoding = decode(
        STANDARD, frames(STANDARD, lambda n: (total_px * n / count, total_px * n / count)), SCENE.projector
    )
    motion = found(decoding)
    assert motion.is_significant
    x, y = np.median(SCENE.errors(decoding), axis=0)
    assert -1.0 < x < -0.5  # where the picture was when the fringes were taken
    assert abs(x - y) < 0.03


def test_a_large_bump_is_refused() -> None:
    at = len(STANDARD) - 10
    motion = found(bumped(STANDARD, at, 0.9, 0.9))
    assert motion.verdict is MotionVerdict.TOO_LARGE
    assert motion.first < at <= motion.last
    assert 0.8 < motion.size_px / np.hypot(0.9, 0.9) < 1.1
    assert re.match(r"the projector, or the camera, moved by more than 0\.84 projector pixels between", str(motion))


def test_a_bump_of_ambiguous_size_is_given_a_lower_bound() -> None:
    motion = found(bumped(STANDARD, len(STANDARD) - 10, 1.2, 1.2))
    assert motion.verdict is MotionVerdict.TOO_LARGE
    assert "moved by more than 0.84 projector pixels between" in str(motion)


def test_coordinates_have_the_share_of_the_shortest_fringe_in_a_bump() -> None:
    """Even if blur makes the longer fringe more precise, the shorter one determines the mean."""
    patterns, px = PRESETS["concave"].patterns(SCENE.projector), 0.2
    at = next(n for n, p in enumerate(patterns) if p == Phase("x", 8.43, 0.75))
    blurred = [
        cv2.GaussianBlur(frame, (0, 0), 1.8).astype(np.uint8)
        for frame in frames(patterns, lambda number: (px, px) if number >= at else (0.0, 0.0))
    ]
    decoding = decode(patterns, blurred, SCENE.projector)
    motion = found(decoding)
    assert motion.is_significant
    assert motion.verdict is MotionVerdict.CORRECTABLE
    assert 0.9 * px < motion.size_px / np.sqrt(2) < 1.1 * px
    x, y = np.median(SCENE.errors(decoding), axis=0)
    assert -1.1 * px < x < -0.9 * px  # where the picture was when the shorter fringes were taken
    assert abs(x - y) < 0.02


def test_inconsistent_fringes_are_attributed_to_the_bump() -> None:
    motion = found(bumped(STANDARD, len(STANDARD) - 2, 1.5, 1.5))
    assert motion.verdict is MotionVerdict.TOO_LARGE
    assert str(motion).startswith("the projector")


def test_a_bump_before_the_fringes_changes_nothing() -> None:
    at = next(number for number, pattern in enumerate(STANDARD) if isinstance(pattern, Phase))
    decoding = bumped(STANDARD, at, 1.0)
    assert found(decoding).verdict is MotionVerdict.NONE
    x, y = np.median(SCENE.errors(decoding), axis=0)
    assert x == pytest.approx(-1.0, abs=0.02)
    assert y == pytest.approx(0.0, abs=0.02)


@dataclass(frozen=True)
class Panned(Scene):
    """Return the scene after a projector of focal length 1.5 widths has panned or tilted: its sides move more."""

    right_px: float = 0.0
    down_px: float = 0.0

    def _plane(self, u: Light, v: Light, shift: float, tilt: float) -> tuple[Light, Light]:
        x, y = super()._plane(u, v, shift, tilt)
        (width, height), focal = self.projector, 1.5 * self.projector[0]
        a, b = (x - (width - 1) / 2) / focal, (y - (height - 1) / 2) / focal
        by_x, by_y = (
            self.right_px * (1 + a * a) + self.down_px * a * b,
            self.down_px * (1 + b * b) + self.right_px * a * b,
        )
        return x - by_x, y - by_y


@pytest.mark.parametrize(
    ("preset", "right_px", "down_px", "said"),
    [
        ("quick", 12.0, 0.0, "x by about 12"),
        ("quick", 0.0, -12.3, "y by about 12"),
        ("standard", -15.8, 0.3, "x by about 16"),
    ],
)
def test_a_period_slip_between_code_and_fringes(preset: PresetName, right_px: float, down_px: float, said: str) -> None:
    patterns = PRESETS[preset].patterns(SCENE.projector)
    after = Panned(SCENE.camera, SCENE.projector, right_px=right_px, down_px=down_px)
    frames = [
        (after if isinstance(pattern, Phase) else SCENE).frame(pattern, number)
        for number, pattern in enumerate(patterns)
    ]
    expected = (
        rf"moved: along {said} projector pixels, or whole periods of .* \(1\d(\.\d)? px\) less, .* from the codes to"
    )
    with pytest.raises(RefusalError, match=expected):
        decode(patterns, frames, SCENE.projector)


def test_a_small_bump_during_the_codes_is_not_reported_as_large() -> None:
    patterns = PRESETS["quick"].patterns(SCENE.projector)
    after = Panned(SCENE.camera, SCENE.projector, right_px=1.5, down_px=0.3)
    frames = [(after if number >= 6 else SCENE).frame(pattern, number) for number, pattern in enumerate(patterns)]
    with pytest.raises(RefusalError, match=r"or whole periods of the fringes \(12\.3 px\) less"):
        decode(patterns, frames, SCENE.projector)


FIRST_OF_Y = next(number for number, pattern in enumerate(APART) if getattr(pattern, "axis", "") == "y")


@pytest.mark.parametrize("patterns", [APART, tuple(p for p in APART if not isinstance(p, Phase))])
def test_no_motion_is_found_between_the_axes_at_rest(patterns: tuple[Pattern, ...]) -> None:
    inside, whole = (found(replace(SCENE, zoom=zoom).decode(patterns)) for zoom in (0.5, 1.6))
    assert inside.verdict is MotionVerdict.NONE
    assert whole.verdict is MotionVerdict.NONE
    assert inside.is_blind  # the camera does not see the border of the picture
    assert not whole.is_blind
    largest = [max(float(np.abs(each.motions).max()) for each in motion.unseen) for motion in (inside, whole)]
    assert 0.2 < largest[0] < 0.4
    assert 0.005 < largest[1] < 0.05


@pytest.mark.parametrize(("right_px", "down_px"), [(0.05, 0.1), (0.15, -0.2), (2.0, 1.0)])
def test_a_camera_that_turned_between_the_axes(right_px: float, down_px: float) -> None:
    after = Turned(SCENE.camera, SCENE.projector, right_px=right_px, down_px=down_px)
    frames = [(after if number >= FIRST_OF_Y else SCENE).frame(pattern, number) for number, pattern in enumerate(APART)]
    decoding = decode(APART, frames, SCENE.projector)
    motion = found(decoding)
    assert motion.is_significant
    assert motion.motion[4:6] == pytest.approx((right_px, down_px), abs=0.02 + 0.1 * abs(down_px))
    assert "the camera moved by" in str(motion)
    assert motion.first < FIRST_OF_Y <= motion.last
    if motion.verdict is MotionVerdict.CORRECTABLE:
        assert np.abs(np.median(SCENE.errors(decoding), axis=0)).max() < 0.03  # taken back


@pytest.mark.parametrize("px", [0.4, 3.0])
def test_a_camera_turn_during_the_fringes_is_not_attributed_to_the_axes(px: float) -> None:
    at = len(STANDARD) - 5
    after = Turned(SCENE.camera, SCENE.projector, right_px=px, down_px=px / 2)
    frames = [(after if number >= at else SCENE).frame(pattern, number) for number, pattern in enumerate(STANDARD)]
    try:
        said = str(found(decode(STANDARD, frames, SCENE.projector)))
    except RefusalError as refusal:
        said = refusal.reason.lower()
    assert "camera" in said
    assert "each somewhere else" not in said


def test_independent_motion_of_each_frame() -> None:
    moves = np.random.default_rng(3).uniform(-0.25, 0.25, (len(STANDARD), 2))
    frames = [
        Turned(SCENE.camera, SCENE.projector, right_px=right, down_px=down).frame(pattern, number)
        for number, (pattern, (right, down)) in enumerate(zip(STANDARD, moves.tolist(), strict=True))
    ]
    decoding = decode(STANDARD, frames, SCENE.projector)
    motion = found(decoding)
    assert motion.course is MotionCourse.FRAME_BY_FRAME
    assert motion.verdict is MotionVerdict.CORRECTABLE
    of_fringes = [number for number, pattern in enumerate(STANDARD) if isinstance(pattern, Phase)]
    size_px = float(np.hypot(*moves[of_fringes].std(axis=0)))
    assert np.hypot(*motion.motion[4:6]) == pytest.approx(size_px, abs=0.025)
    assert re.search(r"each somewhere else, by 0\.\d+ px", str(motion))
    shortest = min(pattern.period for pattern in STANDARD if isinstance(pattern, Phase))
    of_x, of_y = (
        [n for n, p in enumerate(STANDARD) if isinstance(p, Phase) and (p.axis, p.period) == (axis, shortest)]
        for axis in ("x", "y")
    )
    apart = moves[of_x].mean(axis=0) - moves[of_y].mean(axis=0)
    assert np.linalg.norm(apart) > 0.1  # what would be left
    assert motion.shift.motions[0, 4:6] - motion.shift.motions[1, 4:6] == pytest.approx(apart, abs=0.03)
    spread = [float(np.linalg.norm(each.motions[:, 4:6])) for each in motion.unseen]
    assert all(0.005 < each < 0.03 for each in spread)


CODES = tuple(pattern for pattern in APART if not isinstance(pattern, Phase))


@pytest.mark.parametrize(
    ("patterns", "right_px", "down_px"), [(APART, 0.1, 0.25), (CODES, -0.2, 0.1), (CODES, -6.0, 5.0), (CODES, 4.0, 9.0)]
)
def test_a_projector_turn_between_the_axes_is_measured_at_the_border(
    patterns: tuple[Pattern, ...], right_px: float, down_px: float
) -> None:
    whole = replace(Moved(SCENE.camera, SCENE.projector), zoom=1.6)
    after = replace(whole, right_px=right_px, down_px=down_px)
    first_of_y = next(number for number, pattern in enumerate(patterns) if getattr(pattern, "axis", "") == "y")
    frames = [
        (after if number >= first_of_y else whole).frame(pattern, number) for number, pattern in enumerate(patterns)
    ]
    motion = found(decode(patterns, frames, SCENE.projector))
    assert motion.is_significant
    # This picture shifts uniformly, unlike that of a projector that turns.
    assert motion.motion[:2] == pytest.approx((right_px, down_px), abs=max(0.04, 0.1 * np.hypot(right_px, down_px)))
    assert "the projector moved by" in str(motion)
    assert (motion.verdict is MotionVerdict.TOO_LARGE) == (abs(down_px) > 0.5)


@pytest.mark.parametrize("pairs_after", [2, 3])
def test_a_camera_that_turned_before_the_finest_bits_of_a_code(pairs_after: int) -> None:
    at, px = len(CODES) - 2 * pairs_after, 0.3
    after = Turned(SCENE.camera, SCENE.projector, down_px=px)
    decoding = decode(CODES, [(after if n >= at else SCENE).frame(p, n) for n, p in enumerate(CODES)], SCENE.projector)
    motion = found(decoding)
    assert motion.is_significant
    assert motion.motion[5] == pytest.approx(px, abs=0.05)  # not a part of it, as the mean over all pairs
    assert motion.first < at <= motion.last
    share = {2: 0.75, 3: 0.875}[pairs_after]  # of the edges
    assert motion.shift.motions[1, 5] == pytest.approx(share * px, abs=0.05)


def test_stripes_due_to_flicker_are_not_taken_for_motion() -> None:
    brightness = 1 + np.random.default_rng(4).uniform(-0.15, 0.15, len(CODES))
    frames = replace(SCENE, zoom=1.6).frames(CODES)
    flickering = [np.rint(factor * each).astype(np.uint8) for factor, each in zip(brightness, frames, strict=True)]
    motion = found(decode(CODES, flickering, SCENE.projector))
    assert motion.verdict is MotionVerdict.NONE
    assert 0.005 < max(float(np.abs(each.motions).max()) for each in motion.unseen) < 0.05


def test_repeating_the_first_axis_observes_the_motion() -> None:
    again = (*APART, *tuple(phase_sequence("x", 6.7, 4))[:2])
    assert found(SCENE.decode(again)).verdict is MotionVerdict.NONE
    motion = found(bumped(again, FIRST_OF_Y, 0.3))
    assert motion.is_significant
    assert motion.unseen == ()
    assert motion.first < FIRST_OF_Y <= motion.last
    assert 0.2 < motion.size_px < 0.4


def test_a_drift_that_explains_little_is_not_corrected() -> None:
    drift = MotionCourse.DRIFT
    assert MotionVerdict.of(1.5, drift.largest_px(6.7, 0.9), significant=True) is MotionVerdict.CORRECTABLE
    assert MotionVerdict.of(1.5, drift.largest_px(6.7, 0.3), significant=True) is MotionVerdict.TOO_LARGE
    assert MotionVerdict.of(1.5, drift.largest_px(6.7, 0.3), significant=False) is MotionVerdict.NONE


def test_a_bump_of_several_px_in_the_middle_of_a_fringe_is_named() -> None:
    patterns = PRESETS["concave"].patterns(SCENE.projector)
    assert isinstance(patterns[27], Phase)
    with pytest.raises(RefusalError, match="moved between frames 26 and 27"):
        bumped(patterns, 27, 5.0, -4.0)


def test_a_bump_during_a_code_causes_period_slips() -> None:
    patterns = PRESETS["quick"].patterns(SCENE.projector)
    apart = tuple(sorted(patterns, key=lambda pattern: getattr(pattern, "axis", "")))
    of_code = [n for n, pattern in enumerate(apart) if isinstance(pattern, Gray) and pattern.axis == "y"]
    with pytest.raises((InputError, RefusalError), match="move"):
        bumped(apart, max(of_code), 0.0, 3.0)
