"""Frames of one picture against each other: how bright each is, and which shows something else."""

import numpy as np

from calib.numerics import Floats
from scanner.recordings.clocks import Clocks
from scanner.recordings.exposure_times import exposure_begins, frames_between, margin_s, within_slot
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples
from scanner.recordings.steadiness import white_frames

# Frames are outliers of their picture if they differ by this share of the range, and this many times the usual
# difference.
_ODD, _ODD_TIMES = 0.04, 4.0
_FEWEST = 3
_WEAK = 0.05  # share of white: at this brightness, a gain has half its weight


def frame_gains(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Floats:
    """(N,): the brightness of each frame relative to the others of its picture; 0 of one that shows another picture.

    Frames that show no single picture have 1.
    """
    mark = white_frames(samples, programme, clocks)
    white = float(np.median(samples.light(clocks.tone, mark)[:, samples.lit]))
    gains = np.ones(len(samples.times_s))
    odd, measured = np.zeros(len(gains)), np.zeros(len(gains), np.bool_)
    for loop in range(len(clocks.loops)):
        changes = clocks.changes(loop)
        for slot in range(len(programme.mark), len(programme.loop) - len(programme.mark)):
            begins, ends = changes[slot : slot + 2]
            group = frames_between(samples, clocks, begins, ends)
            exposed = exposure_begins(samples, clocks, group, samples.rows)
            group = group[within_slot(exposed, clocks.exposure_s, (begins, ends), margin_s(clocks)).mean(axis=1) > 0.5]
            if len(group) < _FEWEST:
                continue
            seen = samples.light(clocks.tone, group)[:, samples.lit].astype(np.float64)
            middle = np.median(seen, axis=0)
            # A dark picture hardly determines the brightness of its frames.
            weak = len(middle) * (_WEAK * white) ** 2
            gain = (seen @ middle + weak) / (middle @ middle + weak)
            gains[group] = gain
            odd[group] = np.sqrt(np.mean((seen - gain[:, None] * middle) ** 2, axis=1)) / white
            measured[group] = True
    if measured.any():
        limit = max(_ODD, _ODD_TIMES * float(np.median(odd[measured])))
        gains[odd > limit] = 0.0
    return gains
