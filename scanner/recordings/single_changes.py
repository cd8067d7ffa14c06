"""Changes of the picture that do not come evenly: frames that a player or a camera dropped or showed twice."""

from dataclasses import replace

import numpy as np

from calib.numerics import Floats
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples
from scanner.recordings.shares import ROBUST, Shares, loss, misfit, observe, summed

_CANDIDATES = np.linspace(-0.45, 0.45, 91)  # shifts of a change, in slots
_LEAST_SHIFT_S = 0.008  # half a refresh period of a projector
_AS_GOOD = 0.1  # share of the loss of a robust deviation, per row
_GAIN_OF_SHIFT = 0.5  # a shift is accepted if it leaves less than this share of the cost


def with_shifts(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Clocks:
    """Changes that come late or early for good: frames that a player or a camera dropped or showed twice."""
    measured = _measured_shifts(samples, programme, clocks)
    shifts = []
    for loop, (times, before, after) in zip(clocks.loops, measured, strict=True):
        # A change without information takes the shift of the one before.
        kept, current = np.zeros(len(times)), 0.0
        for number in range(len(times)):
            if np.isfinite(times[number]):
                believed = after[number] < _GAIN_OF_SHIFT * before[number] and abs(times[number]) > _LEAST_SHIFT_S
                current = times[number] if believed else 0.0
            kept[number] = current
        shifts.append(np.clip(kept, -0.45 * loop.slot_s, 0.45 * loop.slot_s))
    return replace(clocks, shifts_s=tuple(shifts))


def with_scatter(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Clocks:
    """Return the clocks with the remaining scatter of the changes around their predicted times."""
    measured = _measured_shifts(samples, programme, clocks)
    off = np.concatenate([times - kept for (times, _, _), kept in zip(measured, clocks.shifts_s, strict=True)])
    off = off[np.isfinite(off)]
    return replace(clocks, scatter_s=float(np.sqrt(np.mean(off**2))) if off.size else 0.0)


def _measured_shifts(
    samples: VideoSamples, programme: Programme, clocks: Clocks
) -> list[tuple[Floats, Floats, Floats]]:
    """For each loop and change: the shift from evenness that fits best, NaN where nothing changed; costs without and
    with it.
    """
    even = replace(clocks, shifts_s=tuple(np.zeros_like(each) for each in clocks.shifts_s))
    shares = observe(samples, programme, clocks)
    slots = len(clocks.shifts_s[0])
    costs = np.stack(
        [_cost_of_changes(samples, shares, even, slots * len(clocks.loops), float(by)) for by in _CANDIDATES]
    )
    found = []
    for number, loop in enumerate(clocks.loops):
        of_loop = costs[:, number * slots : (number + 1) * slots]
        best = of_loop.min(axis=0)
        # Of all shifts that fit equally well, as for a change between two exposures, take the one closest to zero.
        seen = shares.seen[number * slots : (number + 1) * slots]
        fits = of_loop <= best + _AS_GOOD * ROBUST**2 * np.maximum(seen, 1)
        nearest = np.where(fits, np.abs(_CANDIDATES)[:, None], np.inf).argmin(axis=0)
        times = np.where(
            shares.seen[number * slots : (number + 1) * slots] > 0, _CANDIDATES[nearest] * loop.slot_s, np.nan
        )
        found.append((times, of_loop[len(_CANDIDATES) // 2], best))
    return found


def _cost_of_changes(samples: VideoSamples, shares: Shares, clocks: Clocks, number: int, by_slots: float) -> Floats:
    """Cost of each change if it came later by this many slots, (number,)."""
    moved = tuple(each + by_slots * loop.slot_s for each, loop in zip(clocks.shifts_s, clocks.loops, strict=True))
    losses = loss(misfit(samples, shares, replace(clocks, shifts_s=moved)))
    return summed(shares.change, losses.reshape(len(shares.change), -1).sum(axis=1), number)
