"""Select the frames that make each picture, row by row: those in which it alone was lit, or a linear unmixing of frames
with known shares.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Ints
from scanner.errors import InputError
from scanner.recordings.clocks import Clocks
from scanner.recordings.exposure_times import exposure_begins, frames_between, margin_s, shown_reversed, within_slot
from scanner.recordings.frame_gains import frame_gains
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples

_SHORT_MARGIN_S = 0.002  # margin next to a change, where no frame keeps the usual one
_NEIGHBOURS = 2  # number of pictures before and after that may be unmixed together
_RIDGE = 0.03  # error of a share
_LEAST_RESOLVED, _MOST_NOISE = 0.9, 4.0
_MOST_ROWS_LOST = 0.3


@dataclass(frozen=True)
class PictureWeights:
    """A picture is the sum of frames `numbers` (n,) times `weights` (n, H); rows without any weight are lost.

    `back` (n,): which of the frames belong to the backward pass. `noise` (H,): noise of the picture relative to that of
    one frame. `alone`: the share of rows that use only frames in which this picture alone was lit.
    """

    numbers: Ints
    weights: Floats
    back: Bools
    noise: Floats
    alone: float


def picture_weights(samples: VideoSamples, programme: Programme, clocks: Clocks) -> list[PictureWeights]:
    """Return the weights of each pattern. Raises InputError if a picture cannot be separated from its neighbours in
    many rows.
    """
    gains = frame_gains(samples, programme, clocks)
    found = [_weights(samples, programme, clocks, pattern, gains) for pattern in range(len(programme.patterns))]
    lost = max(float(np.mean(~each.weights.any(axis=0))) for each in found)
    if lost > _MOST_ROWS_LOST:
        raise InputError(
            f"{samples.video.path}: in {lost:.0%} of the rows a picture cannot be separated from the next. Each "
            f"is shown for {programme.hold_s:.3f} s, at {1 / samples.frame_interval_s:.1f} frames a second and "
            f"exposures of 1/{1 / clocks.exposure_s:.0f} s. Expose shorter, or write the video with a longer --hold"
        )
    return found


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
        for margin, found in ((margin_s(clocks), usual), (max(_SHORT_MARGIN_S, clocks.scatter_s), close)):
            within = within_slot(exposed, clocks.exposure_s, (begins, ends), margin)
            found.append(within & (gains[frames] > 0)[:, None])
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
    unknown = {shown: column for column, shown in enumerate(_around(programme, pattern))}
    for loop, slot in _slots(programme, clocks, pattern):
        changes = clocks.changes(loop)
        first, last = slot - _NEIGHBOURS, min(slot + _NEIGHBOURS, len(programme.loop) - 1)
        seen = frames_between(samples, clocks, changes[first], changes[last + 1])
        begins = exposure_begins(samples, clocks, seen, mixed.astype(np.float64))
        share = np.zeros((*begins.shape, len(unknown)))
        for other in range(first, last + 1):
            overlap = np.minimum(begins + clocks.exposure_s, changes[other + 1]) - np.maximum(begins, changes[other])
            share[..., unknown[programme.loop[other]]] += np.clip(overlap / clocks.exposure_s, 0, 1)
        # A frame that shows other pictures too has no weight in that row.
        share *= (share.sum(axis=2) > 1 - 1e-6)[..., None]
        shares.append(share)
        frames.append(seen)
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
    return list(dict.fromkeys(shown for each in around for shown in each))
