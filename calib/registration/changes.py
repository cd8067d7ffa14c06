"""What has changed between two scans of one place: what deviates, what is new and what is gone, and not what is hidden.

A point is new if the earlier scanner looked through the place where it is, and gone if the later one did. What neither
saw through may have been there, or may still be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Ints
from calib.registration.deviations import CellDeviations, Region, groups
from calib.registration.free_space import FreeSpace

_FEWEST = 6  # adjoining cells
_ONE_CHANGE = 2.5  # cells, of which parts of one change count as adjoining


@dataclass(frozen=True, eq=False)
class Change:
    """Something that changed: parts near each other that deviate, are new or gone."""

    centre: Floats
    """(3,)"""
    size: float
    """Largest distance within it."""
    deviating: float
    """Area that deviates by more than chance."""
    new: float
    """Area where there was free space."""
    gone: float
    """Area where there is free space now."""
    peak: float
    """The largest deviation; 0 if nothing deviates."""
    sigma: float
    """Of the peak."""


def unseen_through(points: Floats, spaces: Sequence[FreeSpace], by: float) -> Bools:
    """Which points (N, 3) none of the scanners looked through, (N,)."""
    through = np.zeros(len(points), np.bool_)
    for space in spaces:
        through |= space.is_violated(points, by)
    return ~through


def find_changes(
    cells: CellDeviations,
    regions: Sequence[Region],
    earlier: Sequence[FreeSpace],
    former: Floats,
    later: Sequence[FreeSpace],
    margin: float,
) -> list[Change]:
    """Changes from an earlier scan to a later one, the largest first.

    `cells`: of the later one, with its deviating `regions`; `former` (F, 3): cells of the earlier one that have no
    counterpart. A point is in free space if it is in front of what was seen by more than a `margin`.
    """
    missing = np.flatnonzero(~np.isfinite(cells.distance))
    new = missing[~unseen_through(cells.points[missing], earlier, margin)]
    gone = former[~unseen_through(former, later, margin)]
    parts = [cells.points[region.cells] for region in regions]
    kinds = [0] * len(parts)
    for number, points in ((1, cells.points[new]), (2, gone)):
        for numbers in groups(points, np.ones(len(points), np.bool_), cells.cell):
            if len(numbers) >= _FEWEST:
                parts.append(points[numbers])
                kinds.append(number)
    if not parts:
        return []
    whole = np.concatenate(parts)
    part = np.repeat(np.arange(len(parts)), [len(each) for each in parts])
    kind: Ints = np.array(kinds, np.int64)[part]
    near = groups(whole, np.ones(len(whole), np.bool_), _ONE_CHANGE * cells.cell)
    changes = [_change(numbers, whole, part, kind, regions, cells) for numbers in near]
    return sorted(changes, key=lambda change: -(change.deviating + change.new + change.gone))


def _change(
    numbers: Ints, whole: Floats, part: Ints, kind: Ints, regions: Sequence[Region], cells: CellDeviations
) -> Change:
    points = whole[numbers]
    deviating, new, gone = (float(np.count_nonzero(kind[numbers] == k)) * cells.area for k in range(3))
    own = [regions[k] for k in np.unique(part[numbers]) if k < len(regions)]
    largest = max(own, key=lambda region: abs(region.peak), default=None)
    centre = points.mean(axis=0)
    size = 2 * float(np.linalg.norm(points - centre, axis=1).max()) + cells.cell
    peak, sigma = (largest.peak, largest.sigma) if largest is not None else (0.0, 0.0)
    return Change(centre, size, deviating, new, gone, peak, sigma)
