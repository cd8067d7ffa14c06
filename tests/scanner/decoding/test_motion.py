"""Motion during a capture of the made-up scene: the projector's picture moves by a known number of pixels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from calib.numerics import Image
from scanner.decoding import Decoding
from scanner.decoding.motion import MotionFound
from scanner.patterns import PRESETS, Pattern, Phase, PresetName, phase_sequence, sequence_for
from tests.support.synthetic_capture import Light, Scene, decode

SCENE = Scene()
STANDARD = sequence_for(SCENE.projector)
# As other programs show them: all along x, then all along y.
APART = tuple(sorted(STANDARD, key=lambda pattern: getattr(pattern, "axis", "")))


@dataclass(frozen=True)
class Moved(Scene):
    """The scene after the picture has moved."""

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


def found(decoding: Decoding) -> MotionFound:
    assert decoding.motion is not None
    return decoding.motion


@pytest.mark.parametrize("preset", PRESETS)
def test_rest_is_no_motion(preset: PresetName) -> None:
    motion = found(SCENE.decode(PRESETS[preset].patterns(SCENE.projector)))
    assert not motion.significant
    assert motion.witnessed
    assert motion.shifts.likely == ()


@pytest.mark.parametrize(("px", "before_the_end"), [(0.1, 8), (0.1, 5), (0.3, 3), (0.3, 10)])
def test_a_bump_among_the_fringes(px: float, before_the_end: int) -> None:
    at = len(STANDARD) - before_the_end
    motion = found(bumped(STANDARD, at, px, px))
    assert motion.significant
    assert not motion.slow
    assert motion.first < at <= motion.last
    assert 0.7 * px < motion.size_px / np.sqrt(2) < 1.3 * px
    assert "the projector moved by" in str(motion)


def test_a_drift_shifts_neither_axis_against_the_other() -> None:
    total_px, count = 1.0, len(STANDARD)
    decoding = decode(
        STANDARD, frames(STANDARD, lambda n: (total_px * n / count, total_px * n / count)), SCENE.projector
    )
    motion = found(decoding)
    assert motion.significant
    x, y = np.median(SCENE.errors(decoding), axis=0)
    assert -1.0 < x < -0.5  # where the picture was when the fringes were taken
    assert abs(x - y) < 0.03


def test_a_large_bump_is_too_large() -> None:
    motion = found(bumped(STANDARD, len(STANDARD) - 10, 0.5, 0.5))
    assert motion.is_too_large
    assert "the projector moved by" in str(motion)


def test_fringes_that_a_bump_has_broken_are_blamed_on_it() -> None:
    motion = found(bumped(STANDARD, len(STANDARD) - 2, 1.5, 1.5))
    assert motion.is_too_large
    assert "the projector moved by" in str(motion)


def test_a_bump_before_the_fringes_changes_nothing() -> None:
    at = next(number for number, pattern in enumerate(STANDARD) if isinstance(pattern, Phase))
    decoding = bumped(STANDARD, at, 1.0)
    assert not found(decoding).significant
    x, y = np.median(SCENE.errors(decoding), axis=0)
    assert x == pytest.approx(-1.0, abs=0.02)
    assert y == pytest.approx(0.0, abs=0.02)


def test_axes_apart_leave_motion_unwitnessed_until_the_first_is_shown_again() -> None:
    at = next(number for number, pattern in enumerate(APART) if getattr(pattern, "axis", "") == "y")
    unseen = found(bumped(APART, at, 0.3))
    assert not unseen.significant
    assert not unseen.witnessed
    assert len(unseen.shifts.possible) == 4
    again = (*APART, *tuple(phase_sequence("x", 6.7, 4))[:2])
    assert found(SCENE.decode(again)).significant is False
    motion = found(bumped(again, at, 0.3))
    assert motion.significant
    assert motion.witnessed
    assert motion.first < at <= motion.last
    assert 0.2 < motion.size_px < 0.4
