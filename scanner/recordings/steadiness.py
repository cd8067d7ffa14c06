"""Whether a camera stood still and kept its exposure, from the white fields of the start marks."""

from collections.abc import Mapping

import cv2
import numpy as np

from calib.numerics import Image, Ints
from scanner.errors import InputError
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import Light, VideoSamples

_TILES = 3
_CLEAR = 0.15  # of phase correlation's response
_NAMED_PX, _REFUSED_PX = 0.3, 2.0
_NAMED_GAIN, _REFUSED_GAIN = 0.03, 0.4
_FEWEST_CLEAR = 3
_WHITES_PER_MARK = 3


def white_frames(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Ints:
    """Numbers of a few frames in the longest white field of each mark, in the order of their times."""
    moments = []
    for loop in range(len(clocks.loops)):
        changes = clocks.changes(loop)
        for mark in (0, programme.slots_between_marks):
            begins, ends = changes[mark + programme.longest_white], changes[mark + programme.longest_white + 1]
            moments += list(np.linspace(begins, ends, _WHITES_PER_MARK))
    return np.unique(np.abs(samples.times_s[:, None] - np.array(moments)).argmin(axis=0))


def moved_px(whites: Mapping[int, Image]) -> float:
    """The largest shift of the picture between the first of the frames and others, in camera pixels."""
    first, *others = [white.astype(np.float32) for white in whites.values()]
    return max((_shift_px(first, other) for other in others), default=0.0)


def _shift_px(first: Light, other: Light) -> float:
    """The median over tiles with a clear answer; 0 where there are none."""
    height, width = (side // _TILES for side in first.shape)
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    shifts = []
    for row in range(_TILES):
        for column in range(_TILES):
            tile = slice(row * height, (row + 1) * height), slice(column * width, (column + 1) * width)
            (x, y), response = cv2.phaseCorrelate(
                np.ascontiguousarray(first[tile]), np.ascontiguousarray(other[tile]), window
            )
            if response > _CLEAR:
                shifts.append(np.hypot(x, y))
    return float(np.median(shifts)) if len(shifts) >= _FEWEST_CLEAR else 0.0


def exposure_range(samples: VideoSamples, numbers: Ints, clocks: Clocks) -> float:
    """How much the brightness of white fields varies, relative to it."""
    levels = samples.light(clocks.tone, numbers)[:, samples.lit].mean(axis=1)
    return float(np.ptp(levels) / np.median(levels))


def notes_on(path: object, shift_px: float, exposure: float) -> tuple[str, ...]:
    """Sentences on what is more than usual. Raises InputError for what spoils a scan."""
    notes = []
    if shift_px > _NAMED_PX:
        moved = f"the picture moved by {shift_px:.1f} px: the camera stood unsteadily, or its stabilisation was on"
        if shift_px > _REFUSED_PX:
            raise InputError(f"{path}: {moved}: put it on a stand and switch stabilisation off")
        notes.append(f"{moved[0].upper()}{moved[1:]}.")
    if exposure > _NAMED_GAIN:
        changed = f"the camera's exposure changed by {exposure:.0%} between white fields"
        if exposure > _REFUSED_GAIN:
            raise InputError(f"{path}: {changed}: lock exposure, ISO and white balance before filming")
        notes.append(f"{changed[0].upper()}{changed[1:]}; lock it.")
    return tuple(notes)
