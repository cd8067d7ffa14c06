"""When rows of frames were exposed, and whether a single picture was shown throughout."""

import numpy as np

from calib.numerics import Bools, Floats, Ints
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples

# Time left out next to a change, if there are enough frames, for the response and scan-out of projectors.
_LONG_MARGIN_S, _MARGIN_OF_SLOT = 0.02, 0.12


def within_slot(begins: Floats, exposure_s: float, slot: tuple[float, float], margin_s: float) -> Bools:
    """Exposures that lie within a slot."""
    return (begins >= slot[0] + margin_s) & (begins + exposure_s <= slot[1] - margin_s)


def margin_s(clocks: Clocks) -> float:
    """The usual one."""
    return max(min(_LONG_MARGIN_S, _MARGIN_OF_SLOT * clocks.loops[0].slot_s), 2 * clocks.scatter_s)


def exposure_begins(samples: VideoSamples, clocks: Clocks, numbers: Ints, rows: Floats) -> Floats:
    """Return when rows of frames begin to be exposed, (n, rows)."""
    delays = clocks.row_delays(rows, samples.middle_row)
    return samples.times_s[numbers][:, None] + delays - clocks.exposure_s / 2


def shown_reversed(samples: VideoSamples, programme: Programme, clocks: Clocks, numbers: Ints) -> Bools:
    """Which of the frames (n,) show pictures in reverse order."""
    times = samples.times_s[numbers]
    loops = [clocks.changes(loop)[[programme.turn, programme.slots_between_marks]] for loop in range(len(clocks.loops))]
    back: Bools = np.any([(times > turn) & (times < end) for turn, end in loops], axis=0)
    return back


def frames_between(samples: VideoSamples, clocks: Clocks, begins: float, ends: float) -> Ints:
    """Frames with a row that is exposed from `begins` to `ends`."""
    reach = clocks.exposure_s + abs(clocks.line_s) * samples.video.size.height
    first, last = np.searchsorted(samples.times_s, (begins - reach, ends + reach))
    return np.arange(first, last)
