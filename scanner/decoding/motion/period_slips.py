"""Knocks by about a whole period between codes and fringes, which lie on their code again, but not everywhere.

A device that turns moves the middle of its picture less than its sides: a pinhole of focal length f that pans by u px
moves the place X by u (1 + X² / f²), and the place (X, Y) of the other axis by u X Y / f². So curvature tells the turn
itself, whatever whole periods are taken off it.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Bools, Floats, Ints
from scanner.decoding.sequence_plan import AxisPlan
from scanner.decoding.significance import HUBER_SIGMAS, SIGNIFICANT_SIGMAS

# Blocks of the projector's picture, along x and y, with so many pixels at least.
_BLOCKS = (8, 6)
_FEWEST = 150
# Fringes lie evenly between the ends of a cell: the middle of these quantiles is off by a hundredth of it. Blocks with
# parts of few cells have another width, by more than this share.
_QUANTILE = 0.04
_WIDTH_OFF = 0.25
_FEWEST_BLOCKS = 12
# Offset, slopes along x and y, of either axis; then the curvatures of a pan and of a tilt.
_SLOPES, _COLUMNS = 3, 8
_ROUNDS = 6
# What moved is believed if nothing else is nearly as likely: a hundredth, in −2 log likelihood.
_CLEARLY = 9.0
# Focal lengths of projectors, in widths of the picture: no less, and no more.
_LEAST_FOCAL, _MOST_FOCAL = 0.8, 2.7


@dataclass(frozen=True)
class Offsets:
    """By how many projector pixels the longest fringe of an axis lies beside the middle of its code's cell, at pixels
    (P,): `px` from a common `mean_px` on, within half a period; `centre` (P,) of the cells, `seen` (P,): both known.
    """

    axis: AxisPlan
    centre: Floats
    px: Floats
    mean_px: float
    seen: Bools

    @property
    def period(self) -> float:
        """Of the fringe, in projector pixels."""
        return self.axis.fringes[0].period


@dataclass(frozen=True)
class PeriodSlip:
    """By `px` or more the middle of the picture moved along an axis, whole periods being a part of it. `sure`: it was
    along this axis; else it may have been along the other one alone, by another size.
    """

    px: float
    sure: bool


def moved_by_periods(x: Offsets, y: Offsets) -> tuple[PeriodSlip | None, PeriodSlip | None]:
    """How the picture moved along x and y where whole periods are a part of it; else None."""
    axes, width = (x, y), x.axis.length
    seen = np.flatnonzero(x.seen & y.seen)
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
    fit, moved, sure = _likeliest(np.array(rows), np.array(offsets))
    of_x, of_y = (
        _by_periods(each.period, fit.found[_SLOPES * number], fit.found[number - 2], fit.sigma[number - 2])
        if moved[number]
        else 0.0
        for number, each in enumerate(axes)
    )
    return PeriodSlip(of_x, sure[0]) if of_x else None, PeriodSlip(of_y, sure[1]) if of_y else None


def _blocks(place: Floats, height: float) -> list[Ints]:
    """The pixels of each block, given their places (P, 2) in widths of the picture from its middle."""
    columns, rows = _BLOCKS
    column = np.clip((place[:, 0] + 0.5) * columns, 0, columns - 1).astype(np.int64)
    row = np.clip((place[:, 1] / height + 0.5) * rows, 0, rows - 1).astype(np.int64)
    number = row * columns + column
    return [members for k in range(columns * rows) if len(members := np.flatnonzero(number == k)) >= _FEWEST]


def _offset(axis: Offsets, pixels: Ints) -> float | None:
    """By how much the fringe lies beside the cells in a block; None if these pixels do not fill cells evenly."""
    low, high = np.quantile(axis.px[pixels], [_QUANTILE, 1 - _QUANTILE])
    filled = float(high - low) / ((1 - 2 * _QUANTILE) * axis.axis.cell)
    return float(low + high) / 2 if abs(filled - 1) < _WIDTH_OFF else None


def _row(number: int, place: Floats) -> Floats:
    """What each parameter does to the offset of an axis, (8,), in the mean over places (P, 2)."""
    (x, y), row = place.T, np.zeros(_COLUMNS)
    row[_SLOPES * number : _SLOPES * (number + 1)] = 1, x.mean(), y.mean()
    row[-2:] = np.mean(place * place[:, [number]], axis=0)
    return row


@dataclass(frozen=True)
class _Fit:
    """Parameters and their standard deviations, (8,); what is left of M blocks, (M,), and how far that scatters."""

    found: Floats
    sigma: Floats
    left: Floats
    scale: float

    def cost(self, scale: float) -> float:
        """−2 log likelihood if blocks scatter so, and some are off by more (Huber)."""
        off = np.abs(self.left) / scale
        return float(np.sum(np.where(off < HUBER_SIGMAS, off**2, HUBER_SIGMAS * (2 * off - HUBER_SIGMAS))))


def _likeliest(rows: Floats, offsets: Floats) -> tuple[_Fit, list[bool], list[bool]]:
    """The fit to blocks (M, 8) and (M,), which axes have moved, and which have so for sure: what is less likely by far
    otherwise.
    """
    both, of_y = _fitted(rows, offsets), rows[:, _SLOPES] != 0
    resting = []
    for blocks in (~of_y, of_y):
        bent = rows.copy()
        bent[blocks, -2:] = 0.0
        resting.append(_fitted(bent, offsets))
    worse = [fit.cost(both.scale) - both.cost(both.scale) for fit in resting]
    likelier = int(worse[1] < worse[0])
    if worse[likelier] > -_CLEARLY:
        return both, [True, True], [by > _CLEARLY for by in worse]
    return resting[likelier], [axis != likelier for axis in (0, 1)], [by > _CLEARLY for by in worse]


def _fitted(rows: Floats, offsets: Floats) -> _Fit:
    """Robust least squares, of blocks (M, 8) and (M,)."""
    weights, scale = np.ones(len(rows)), 1.0
    found: Floats = np.zeros(_COLUMNS)
    left, inverse = offsets, np.eye(_COLUMNS)
    for _ in range(_ROUNDS):
        inverse = np.linalg.pinv(rows.T @ (weights[:, None] * rows)).astype(np.float64)
        found = inverse @ rows.T @ (weights * offsets)
        left = offsets - rows @ found
        scale = SIGMA_PER_MEDIAN * float(np.median(np.abs(left))) * len(rows) / max(len(rows) - _COLUMNS, 1)
        weights = np.minimum(1.0, HUBER_SIGMAS * scale / np.maximum(np.abs(left), 1e-9))
    return _Fit(found, scale * np.sqrt(np.diag(inverse)), left, scale)


def _by_periods(period: float, offset_px: float, curvature: float, sigma: float) -> float:
    """An offset in the middle of the picture with the one whole period, of perhaps several, that such a curvature asks
    for, in px per width²; 0 without any.
    """
    least, most = sorted((0.0, offset_px / _LEAST_FOCAL**2))
    beyond = curvature - min(max(curvature, least), most)
    if abs(beyond) < max(SIGNIFICANT_SIGMAS * sigma, period / _MOST_FOCAL**2):
        return 0.0
    return float(offset_px + np.sign(beyond) * period)
