"""Select the frames that make each picture, row by row: those in which it alone was lit, or a linear unmixing of frames
with known shares.

Frames of one picture are compared with each other: how bright each is, and which shows something else.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Ints
from scanner.errors import InputError
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples
from scanner.recordings.steadiness import white_frames

_SHORT_MARGIN_S = 0.002  # margin next to a change, where no frame keeps the usual one
_NEIGHBOURS = 2  # number of pictures before and after that may be unmixed together
_RIDGE = 0.03  # error of a share
_LEAST_RESOLVED, _MOST_NOISE = 0.9, 4.0
_MOST_ROWS_LOST = 0.3
# Frames are outliers of their picture if they differ by this share of the range, and this many times the usual
# difference.
_ODD, _ODD_TIMES = 0.04, 4.0
_FEWEST = 3
_WEAK = 0.05  # share of white: at this brightness, a gain has half its weight
# Time left out next to a change, if there are enough frames, for the response and scan-out of projectors.
_LONG_MARGIN_S, _MARGIN_OF_SLOT = 0.02, 0.12


@dataclass(frozen=True)
class PictureWeights:
    """A picture as a weighted sum of frames; rows without any weight are lost."""

    numbers: Ints
    """Of the frames, (n,)."""
    weights: Floats
    """Of each frame in each row, (n, H)."""
    back: Bools
    """Which of the frames belong to the backward pass, (n,)."""
    noise: Floats
    """Of the picture relative to that of one frame, (H,)."""
    alone: float
    """The share of rows that use only frames in which this picture alone was lit."""


def picture_weights(samples: VideoSamples, programme: Programme, clocks: Clocks) -> list[PictureWeights]:
    """Return the weights of each pattern. Raises InputError if a picture cannot be separated from its neighbours in
    many rows.
    """
    gains = frame_gains(samples, programme, clocks)
    weights = [_weights(samples, programme, clocks, pattern, gains) for pattern in range(len(programme.patterns))]
    lost = max(float(np.mean(~frame_weights.weights.any(axis=0))) for frame_weights in weights)
    if lost > _MOST_ROWS_LOST:
        raise InputError(
            f"{samples.video.path}: in {lost:.0%} of the rows a picture cannot be separated from the next. Each "
            f"is shown for {programme.hold_s:.3f} s, at {1 / samples.frame_interval_s:.1f} frames a second and "
            f"exposures of 1/{1 / clocks.exposure_s:.0f} s. Expose shorter, or write the video with a longer --hold"
        )
    return weights


def _slots(programme: Programme, clocks: Clocks, pattern: int) -> list[tuple[int, int]]:
    """(loop, slot) in which a pattern was shown."""
    return [(number, slot) for number in range(len(clocks.loops)) for slot in programme.slots_of(pattern)]


def _weights(
    samples: VideoSamples, programme: Programme, clocks: Clocks, pattern: int, gains: Floats
) -> PictureWeights:
    rows = np.arange(samples.video.size.height, dtype=np.float64)
    numbers = list[Ints]()
    usual, close = list[Bools](), list[Bools]()
    for loop, slot in _slots(programme, clocks, pattern):
        begins, ends = clocks.changes(loop)[slot : slot + 2]
        frames = frames_between(samples, clocks, begins, ends)
        exposed = exposure_begins(samples, clocks, frames, rows)
        numbers.append(frames)
        for margin, masks in ((margin_s(clocks), usual), (max(_SHORT_MARGIN_S, clocks.scatter_s), close)):
            within = within_slot(exposed, clocks.exposure_s, (begins, ends), margin)
            masks.append(within & (gains[frames] > 0)[:, None])
    number, far, any_distance = np.concatenate(numbers), np.concatenate(usual), np.concatenate(close)
    chosen = np.where(far.any(axis=0), far, any_distance)
    count = chosen.sum(axis=0)
    weights = chosen / np.maximum(count, 1) / np.where(gains[number] > 0, gains[number], 1)[:, None]
    mixed = np.flatnonzero(count == 0)
    if mixed.size:
        number, weights = _unmixed(samples, programme, clocks, pattern, number, weights, mixed)
    used = weights.any(axis=1)
    number, weights = number[used], weights[used]
    back = shown_reversed(samples, programme, clocks, number)
    return PictureWeights(number, weights, back, np.linalg.norm(weights, axis=0), 1 - len(mixed) / len(rows))


def _unmixed(
    samples: VideoSamples,
    programme: Programme,
    clocks: Clocks,
    pattern: int,
    number: Ints,
    weights: Floats,
    mixed: Ints,
) -> tuple[Ints, Floats]:
    """The same with the rows `mixed` by least squares from frames of it and its neighbours, whose shares are known."""
    shares, frames = [], []
    unknown = {neighbour: column for column, neighbour in enumerate(_around(programme, pattern))}
    for loop, slot in _slots(programme, clocks, pattern):
        changes = clocks.changes(loop)
        first, last = slot - _NEIGHBOURS, min(slot + _NEIGHBOURS, len(programme.loop) - 1)
        numbers = frames_between(samples, clocks, changes[first], changes[last + 1])
        begins = exposure_begins(samples, clocks, numbers, mixed.astype(np.float64))
        share = np.zeros((*begins.shape, len(unknown)))
        for near in range(first, last + 1):
            overlap = np.minimum(begins + clocks.exposure_s, changes[near + 1]) - np.maximum(begins, changes[near])
            share[..., unknown[programme.loop[near]]] += np.clip(overlap / clocks.exposure_s, 0, 1)
        # A frame that shows other pictures too has no weight in that row.
        share *= (share.sum(axis=2) > 1 - 1e-6)[..., None]
        shares.append(share)
        frames.append(numbers)
    share, frame = np.concatenate(shares).transpose(1, 0, 2), np.concatenate(frames)
    column = unknown[pattern]
    normal = np.swapaxes(share, 1, 2) @ share + _RIDGE**2 * np.eye(len(unknown))
    solved = np.linalg.solve(normal, np.swapaxes(share, 1, 2))[:, column]  # (rows, frames)
    resolved = np.einsum("rn,rn->r", solved, share[:, :, column])
    noise = np.linalg.norm(solved, axis=1)
    good = (resolved > _LEAST_RESOLVED) & (noise < _MOST_NOISE)
    both = np.union1d(number, frame)
    total = np.zeros((len(both), weights.shape[1]))
    # A frame may be close to both times that a picture is shown.
    np.add.at(total, np.searchsorted(both, number), weights)
    np.add.at(total, np.ix_(np.searchsorted(both, frame), mixed[good]), solved[good].T)
    return both, total


def _around(programme: Programme, pattern: int) -> list[int]:
    """Return the patterns shown within `_NEIGHBOURS` slots of a pattern, each once."""
    around = [programme.loop[slot - _NEIGHBOURS : slot + _NEIGHBOURS + 1] for slot in programme.slots_of(pattern)]
    return list(dict.fromkeys(neighbour for window in around for neighbour in window))


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
            levels = samples.light(clocks.tone, group)[:, samples.lit].astype(np.float64)
            middle = np.median(levels, axis=0)
            # A dark picture hardly determines the brightness of its frames.
            weak = len(middle) * (_WEAK * white) ** 2
            gain = (levels @ middle + weak) / (middle @ middle + weak)
            gains[group] = gain
            odd[group] = np.sqrt(np.mean((levels - gain[:, None] * middle) ** 2, axis=1)) / white
            measured[group] = True
    if measured.any():
        limit = max(_ODD, _ODD_TIMES * float(np.median(odd[measured])))
        gains[odd > limit] = 0.0
    return gains


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
