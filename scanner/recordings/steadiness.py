"""Whether a camera stood still and kept its exposure, from the white fields of the start marks."""

from collections.abc import Iterator, Mapping

import cv2
import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Image, Ints
from scanner.errors import InputError
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import LONGEST_WHITE, Programme
from scanner.recordings.samples import Light, VideoSamples
from scanner.shown_text import capitalised

_TILES, _TILE_PX = 3, 256
_CLEAR = 0.8  # least correlation
_ITERATIONS = 30
_NAMED_PX, _REFUSED_PX = 0.3, 2.0
_NAMED_GAIN, _REFUSED_GAIN = 0.03, 0.4
_FEWEST_CLEAR = 3
_WHITES_PER_MARK = 3

PICTURE_MOVED = FindingKind(
    "picture-moved",
    "The picture of a film moved: the camera stood unsteadily, or its stabilisation was on.",
    "Put the camera on a stand, and switch stabilisation off.",
    ("moved_px",),
)
EXPOSURE_CHANGED = FindingKind(
    "exposure-changed",
    "The exposure of a film changed between its white fields.",
    "Lock exposure, ISO and white balance before filming.",
    ("exposure_share",),
)


def white_frames(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Ints:
    """Numbers of a few frames in the longest white field of each mark, in the order of their times."""
    moments = []
    for loop in range(len(clocks.loops)):
        changes = clocks.changes(loop)
        for mark in (0, programme.slots_between_marks):
            begins, ends = changes[mark + LONGEST_WHITE], changes[mark + LONGEST_WHITE + 1]
            moments += list(np.linspace(begins, ends, _WHITES_PER_MARK))
    return np.unique(np.abs(samples.times_s[:, None] - np.array(moments)).argmin(axis=0))


def moved_px(whites: Mapping[int, Image]) -> float:
    """The largest shift of the picture between the first of the frames and others, in camera pixels."""
    first, *later = [white.astype(np.float32) for white in whites.values()]
    return max((_shift_px(first, second) for second in later), default=0.0)


def _shift_px(first: Light, second: Light) -> float:
    """Median shift over tiles with a clear result; 0 without any."""
    height, width = (side // _TILES for side in first.shape)
    tall, wide = min(height, _TILE_PX), min(width, _TILE_PX)
    shifts = []
    for top in range(height // 2 - tall // 2, first.shape[0] - tall + 1, height):
        for left in range(width // 2 - wide // 2, first.shape[1] - wide + 1, width):
            tile = slice(top, top + tall), slice(left, left + wide)
            shift = _shift_of_tile(np.ascontiguousarray(first[tile]), np.ascontiguousarray(second[tile]))
            if shift is not None:
                shifts.append(shift)
    return float(np.median(shifts)) if len(shifts) >= _FEWEST_CLEAR else 0.0


def _shift_of_tile(first: Light, second: Light) -> float | None:
    """Return the shift of maximal correlation (Evangelidis and Psarakis, TPAMI 30, 2008); None where nothing agrees
    well.
    """
    at_rest = np.eye(2, 3, dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _ITERATIONS, 1e-4)
    try:
        clear, move = cv2.findTransformECC(first, second, at_rest, cv2.MOTION_TRANSLATION, criteria)
    except cv2.error:  # no texture, or no convergence
        return None
    return float(np.hypot(move[0, 2], move[1, 2])) if clear > _CLEAR else None


def exposure_range(samples: VideoSamples, numbers: Ints, clocks: Clocks) -> float:
    """Return the range of the brightness of white fields, relative to their brightness."""
    levels = samples.light(clocks.tone, numbers)[:, samples.lit].mean(axis=1)
    return float(np.ptp(levels) / np.median(levels))


def findings_on_steadiness(path: object, shift_px: float, exposure: float) -> Iterator[Finding]:
    """Warnings about unusual motion and exposure. Raises InputError if they spoil a scan."""
    if shift_px > _NAMED_PX:
        moved = f"the picture moved by {shift_px:.1f} px: the camera stood unsteadily, or its stabilisation was on"
        if shift_px > _REFUSED_PX:
            raise InputError(f"{path}: {moved}: put it on a stand and switch stabilisation off")
        yield Finding(PICTURE_MOVED, Severity.WARNING, f"{capitalised(moved)}.", data={"moved_px": shift_px})
    if exposure > _NAMED_GAIN:
        changed = f"the camera's exposure changed by {exposure:.0%} between white fields"
        if exposure > _REFUSED_GAIN:
            raise InputError(f"{path}: {changed}: lock exposure, ISO and white balance before filming")
        message = f"{capitalised(changed)}; lock it."
        yield Finding(EXPOSURE_CHANGED, Severity.WARNING, message, data={"exposure_share": exposure})
