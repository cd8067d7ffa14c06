"""Changes of the picture that do not come evenly: frames that a player or a camera dropped or showed twice."""

from dataclasses import replace

import numpy as np

from calib.numerics import Floats
from scanner.recordings.clocks import Clocks
from scanner.recordings.shares import ROBUST, Shares, loss, misfit

_CANDIDATES = np.linspace(-0.45, 0.45, 91)  # shifts of a change, in slots
_LEAST_SHIFT_S = 0.008  # half a refresh period of a projector
_AS_GOOD = 0.1  # share of the loss of a robust deviation, per row
_GAIN_OF_SHIFT = 0.5  # a shift is accepted if it leaves less than this share of the cost


def with_shifts(shares: Shares, clocks: Clocks) -> Clocks:
    """Changes that come late or early for good: frames that a player or a camera dropped or showed twice."""
    measured = _measured_shifts(shares, clocks)
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


def with_scatter(shares: Shares, clocks: Clocks) -> Clocks:
    """Return the clocks with the remaining scatter of the changes around their predicted times."""
    measured = _measured_shifts(shares, clocks)
    off = np.concatenate([times - kept for (times, _, _), kept in zip(measured, clocks.shifts_s, strict=True)])
    off = off[np.isfinite(off)]
    return replace(clocks, scatter_s=float(np.sqrt(np.mean(off**2))) if off.size else 0.0)


def _measured_shifts(shares: Shares, clocks: Clocks) -> list[tuple[Floats, Floats, Floats]]:
    """For each loop and change: the shift from evenness that fits best, NaN where nothing changed; costs without and
    with it.
    """
    even = replace(clocks, shifts_s=tuple(np.zeros_like(shifts) for shifts in clocks.shifts_s))
    costs = np.stack([_cost_of_changes(shares, even, by_slots) for by_slots in _CANDIDATES.tolist()])
    best = costs.min(axis=0)
    # Of all shifts that fit equally well, as for a change between two exposures, take the one closest to zero.
    fits = costs <= best + _AS_GOOD * ROBUST**2 * np.maximum(shares.weight_of_changes, 1)
    nearest = np.where(fits, np.abs(_CANDIDATES)[:, None], np.inf).argmin(axis=0)
    by_slots = np.where(shares.weight_of_changes > 0, _CANDIDATES[nearest], np.nan)
    loops = len(clocks.loops)
    parts = (np.split(values, loops) for values in (by_slots, costs[len(_CANDIDATES) // 2], best))
    return [
        (loop.slot_s * of_loop, before, after)
        for loop, of_loop, before, after in zip(clocks.loops, *parts, strict=True)
    ]


def _cost_of_changes(shares: Shares, clocks: Clocks, by_slots: float) -> Floats:
    """Cost of each change if it came later by this many slots, (changes,)."""
    moved = tuple(shifts + by_slots * loop.slot_s for shifts, loop in zip(clocks.shifts_s, clocks.loops, strict=True))
    return shares.summed(loss(misfit(shares, replace(clocks, shifts_s=moved))))
