"""Detection of period slips: bumps by about a whole period between codes and fringes.

The fringes then agree with their code again, but not everywhere, since a turn moves the middle of the picture less than
its sides. A pinhole of focal length f that pans by u px moves the place X by u (1 + X² / f²), and the place (X, Y) of
the other axis by u X Y / f². This curvature reveals the turn itself, whatever whole periods are subtracted.
"""

from dataclasses import dataclass
from math import inf

import numpy as np

from calib.numerics import Bools, Floats, Ints, quantile
from scanner.decoding.motion.robust_fit import RobustFit, robust_fit
from scanner.decoding.sequence_plan import AxisPlan
from scanner.decoding.significance import FEWEST_PIXELS, REJECTED, SIGNIFICANT_SIGMAS
from scanner.decoding.subsampling import ENOUGH_PIXELS, evenly_spread

_BLOCKS = (8, 6)  # of the projector's picture along x and y
# Offsets fill a cell evenly, so that the middle of these quantiles is accurate to a hundredth of it. Blocks of partial
# cells are rejected, whose width differs by more than this share.
_QUANTILE = 0.04
_WIDTH_OFF = 0.25
_FEWEST_BLOCKS = 12  # for eight parameters
# Offset, slopes along x and y, of either axis; then the curvatures of a pan and of a tilt.
_SLOPES, _COLUMNS = 3, 8
# Least and largest focal length of projectors, in widths of the picture.
_LEAST_FOCAL, _MOST_FOCAL = 0.8, 2.7


@dataclass(frozen=True)
class Offsets:
    """Offsets of the longest fringe of an axis from the middle of the code's cell, in projector pixels, at pixels (P,).

    `px`: relative to the common `mean_px`, within half a period. `centre` (P,): middles of the cells. `seen` (P,):
    whether both are known.
    """

    axis: AxisPlan
    centre: Floats
    px: Floats
    mean_px: float
    seen: Bools

    @property
    def period(self) -> float:
        """Period of the fringe in projector pixels."""
        return self.axis.fringes[0].period


@dataclass(frozen=True)
class PeriodSlip:
    """A motion of the middle of the picture along an axis by `px` or more, including whole periods.

    `sure`: whether it was along this axis; otherwise it may have been along the other one alone, by another amount.
    """

    px: float
    sure: bool


def moved_by_periods(x: Offsets, y: Offsets) -> tuple[PeriodSlip | None, PeriodSlip | None]:
    """Return the motions along x and y that include whole periods; None for an axis without one."""
    axes, width = (x, y), x.axis.length
    seen = evenly_spread(np.flatnonzero(x.seen & y.seen), 4 * ENOUGH_PIXELS)  # some hundreds for each block
    place = np.stack([(each.centre[seen] - (each.axis.length - 1) / 2) / width for each in axes], axis=1)
    rows, offsets = [], []
    for members in _blocks(place, y.axis.length / width):
        for number, each in enumerate(axes):
            offset = _offset(each, seen[members])
            if offset is not None:
                rows.append(_row(number, place[members]))
                offsets.append(each.mean_px + offset)
    if len(rows) < _FEWEST_BLOCKS:
        return None, None
    alone = _may_move_alone(x.axis, y.axis), _may_move_alone(y.axis, x.axis)
    fit, moved, sure = _likeliest(np.array(rows), np.array(offsets), alone)
    sigma = fit.scale * np.sqrt(np.diag(fit.inverse))
    of_x, of_y = (
        _by_periods(each.period, fit.found[_SLOPES * number], fit.found[number - 2], sigma[number - 2])
        if moved[number]
        else 0.0
        for number, each in enumerate(axes)
    )
    return PeriodSlip(of_x, sure[0]) if of_x else None, PeriodSlip(of_y, sure[1]) if of_y else None


def _blocks(place: Floats, height: float) -> list[Ints]:
    """Return the pixels of each block, from places (P, 2) relative to the middle of the picture, in its widths."""
    columns, rows = _BLOCKS
    column = np.clip((place[:, 0] + 0.5) * columns, 0, columns - 1).astype(np.int64)
    row = np.clip((place[:, 1] / height + 0.5) * rows, 0, rows - 1).astype(np.int64)
    number = row * columns + column
    ordered = np.argsort(number, kind="stable")
    blocks = np.split(ordered, np.cumsum(np.bincount(number, minlength=columns * rows))[:-1])
    return [members for members in blocks if len(members) >= FEWEST_PIXELS]


def _offset(axis: Offsets, pixels: Ints) -> float | None:
    """Return the offset of the fringe from the cells in a block; None if they are not filled evenly."""
    low, high = (quantile(axis.px[pixels], share) for share in (_QUANTILE, 1 - _QUANTILE))
    filled = (high - low) / ((1 - 2 * _QUANTILE) * axis.axis.cell)
    return (low + high) / 2 if abs(filled - 1) < _WIDTH_OFF else None


def _row(number: int, place: Floats) -> Floats:
    """Return the derivative (8,) of the offset of an axis by each parameter, averaged over places (P, 2)."""
    (x, y), row = place.T, np.zeros(_COLUMNS)
    row[_SLOPES * number : _SLOPES * (number + 1)] = 1, x.mean(), y.mean()
    row[-2:] = np.mean(place * place[:, [number]], axis=0)
    return row


def _may_move_alone(axis: AxisPlan, other: AxisPlan) -> bool:
    """Return whether a bump may be among the frames of an axis, but not among those of the other one."""
    (first, last), (of_other, to_other) = (
        (min(frames), max(frames))
        for frames in (
            [*each.fringes[0].frames, *(frame for code in each.codes for frame in code.frames)]
            for each in (axis, other)
        )
    )
    return first < of_other or last > to_other


def _likeliest(rows: Floats, offsets: Floats, alone: tuple[bool, bool]) -> tuple[RobustFit, list[bool], list[bool]]:
    """Return the best fit to blocks (M, 8) and (M,), which axes moved, and which of these moved for certain.

    It is certain if the alternative is impossible, or far less likely. `alone`: whether x or y may have moved alone.
    """
    both, of_y = robust_fit(rows.T, offsets), rows[:, _SLOPES] != 0
    resting = []
    for blocks in (~of_y, of_y):
        bent = rows.copy()
        bent[blocks, -2:] = 0.0
        resting.append(robust_fit(bent.T, offsets))
    worse = [
        fit.cost(both.scale) - both.cost(both.scale) if possible else inf
        for fit, possible in zip(resting, reversed(alone), strict=True)
    ]
    likelier = int(worse[1] < worse[0])
    if worse[likelier] > -REJECTED:
        return both, [True, True], [by > REJECTED for by in worse]
    return resting[likelier], [axis != likelier for axis in (0, 1)], [by > REJECTED for by in worse]


def _by_periods(period: float, offset_px: float, curvature: float, sigma: float) -> float:
    """Return the offset in the middle of the picture plus one whole period, or 0 if the curvature, in px per width²,
    needs none.
    """
    least, most = sorted((0.0, offset_px / _LEAST_FOCAL**2))
    beyond = curvature - min(max(curvature, least), most)
    if abs(beyond) < max(SIGNIFICANT_SIGMAS * sigma, period / _MOST_FOCAL**2):
        return 0.0
    return float(offset_px + np.sign(beyond) * period)
