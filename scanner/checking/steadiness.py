"""Detect drift during the check, from the same fringes and the same white at its beginning and its end.

The phase gives the change of each pixel's projector coordinate. A rotation of the projector or of the camera is fitted
to these changes. The same pictures are compared, in settled frames, so that no other effect (ghosting, a nonlinear
response) is taken for motion. A lamp that is still warming up changes its brightness.
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats, Ints, grey
from hw.rig import Frame, Rig
from scanner.checking.light import Light, photograph_light
from scanner.checking.report import CheckRow
from scanner.decoding.motion import RigidFit, fit_motion, moved_device, shifts_by_motion
from scanner.patterns import Axis, Pattern, Phase, phase_sequence
from scanner.quantities import plain

Levels = Mapping[tuple[Axis, float], Floats]

_NAME = "steadiness"
_STEPS = 4
_AXES: tuple[Axis, Axis] = ("x", "y")
# Long enough that no motion is mistaken by a whole period, short enough to show small motions.
PERIOD_PX = 12.3
_MOST_PIXELS = 4_000
_TILE_PX = 16
# Motion that the decoder corrects without loss, in pixels of either device.
_MOST_PX = 0.1
_SURE = 5.0
# A warm lamp is stable to a few thousandths.
_MOST_PERCENT = 0.5

CHECKED_STEADINESS = FindingKind(
    "check-steadiness",
    "What scan check says of drift of the devices and of the light.",
    "Let the projector warm up, and fasten both devices.",
)


@dataclass(frozen=True)
class InitialState:
    """The state at time `since_s`: `light`, and the `levels` (H, W) of each of the fringes."""

    since_s: float
    light: Light
    levels: Levels


def patterns() -> tuple[Pattern, ...]:
    """The fringes that are shown, and shown again."""
    return tuple(pattern for axis in _AXES for pattern in phase_sequence(axis, PERIOD_PX, _STEPS))


def levels_of(frames: Iterable[tuple[Pattern, Frame]]) -> Levels:
    """Return the levels of frames of `patterns()`. Raises DeviceError."""
    return {(pattern.axis, pattern.shift): grey(frame.image) for pattern, frame in frames if isinstance(pattern, Phase)}


def steadiness_row(rig: Rig, before: InitialState, now: Levels, projector_px: Floats) -> CheckRow | None:
    """What has changed when the fringes look like this `now`, by where pixels look, (H, W, 2), NaN where that is not
    known; None if it is nowhere. Raises DeviceError.
    """
    moved = _moved(before, now, projector_px, rig.projector.size)
    after = photograph_light(rig, 3, 2)
    where = before.light.well_lit & after.well_lit
    seconds = time.monotonic() - before.since_s
    if moved is None or not where.any():
        return None
    percent = 100 * (after.mean_white[where].mean() / before.light.mean_white[where].mean() - 1)
    return row_of(moved, float(percent), seconds)


def row_of(fit: RigidFit, percent: float, seconds: float) -> CheckRow:
    """The row for a motion and a change of brightness within some seconds."""
    px = float(np.hypot(*fit.motion.reshape(2, -1)[:, :2].T).max())
    sure = fit.significance > _SURE
    moving = f"{moved_device(fit.motion)}" if sure else "nothing moved by more than noise"
    finding = f"within {seconds:.0f} s {moving}, and white changed by {plain(percent, 2, signed=True)} %"
    advice = []
    if sure and px > _MOST_PX:
        advice.append("Fasten what moves, or let it settle: a capture tolerates a tenth of a pixel.")
    if abs(percent) > _MOST_PERCENT:
        advice.append("The projector is not warm yet: give it a quarter of an hour with a picture on, and check again.")
    return CheckRow(
        _NAME, Finding(CHECKED_STEADINESS, Severity.WARNING if advice else Severity.NOTE, finding, " ".join(advice))
    )


def _moved(before: InitialState, now: Levels, projector_px: Floats, projector_size: tuple[int, int]) -> RigidFit | None:
    by_y, by_x = (np.gradient(projector_px, axis=axis) for axis in (0, 1))
    known = before.light.well_lit & np.isfinite(np.concatenate([projector_px, by_x, by_y], axis=2)).all(axis=2)
    row, column = np.nonzero(known)
    chosen = np.linspace(0, len(row) - 1, min(len(row), _MOST_PIXELS)).astype(np.int64)
    if not len(chosen):
        return None
    place = row[chosen], column[chosen]
    was, gradient = projector_px[place], np.stack([by_x[place], by_y[place]], axis=2)
    changed = np.stack([_change(axis, before.levels, now, place) for axis in _AXES], axis=1)
    height, width = known.shape
    camera_px = np.stack([place[1], place[0]], axis=1).astype(np.float64)
    design = shifts_by_motion(camera_px, was, gradient, (width, height), projector_size)
    spread = np.maximum(np.median(np.abs(changed - np.median(changed, axis=0)), axis=0), 1e-3)
    _, group = np.unique(place[0] // _TILE_PX * width + place[1] // _TILE_PX, return_inverse=True)
    return fit_motion(design / spread[:, None], changed / spread, group.reshape(-1))


def _change(axis: Axis, before: Levels, now: Levels, place: tuple[Ints, Ints]) -> Floats:
    """Return the change of the projector coordinate that pixels (P,) see."""
    change: Floats = _phase(axis, now, place) - _phase(axis, before, place)
    return PERIOD_PX * (change - np.rint(change))


def _phase(axis: Axis, levels: Levels, place: tuple[Ints, Ints]) -> Floats:
    """(P,) in cycles."""
    first, second, third, fourth = (levels[axis, step / _STEPS][place] for step in range(_STEPS))
    return np.arctan2(fourth - second, first - third) / (2 * np.pi)
