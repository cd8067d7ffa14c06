"""Passes over all matches, compiled: how far the planes reach in the image, and sums over cells of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry import Matches, mapped
from calib.numerics import Floats, Ints, compiled, in_pieces

_DEGREE = 4  # `polynomial.DEGREE`, told to the compiler: twice as fast as a number that it does not know


@dataclass(frozen=True)
class Extent:
    """Of the matches on one plane: their number, and the lowest and the highest of their camera pixels, (2,)."""

    count: int
    low: Floats
    high: Floats


@dataclass(frozen=True)
class Raster:
    """Square cells of `side` pixels from `low` (2,); `columns` × `rows` of them."""

    low: Floats
    side: float
    columns: int
    rows: int

    def __len__(self) -> int:
        return self.columns * self.rows

    def number(self, camera_px: Floats) -> Ints:
        """Number of the cell (N,) of each pixel (N, 2)."""
        place = ((camera_px - self.low) / self.side).astype(np.int32)
        number: Ints = np.asarray(place[:, 1] * self.columns + place[:, 0], np.int32)
        return number


@dataclass(frozen=True)
class Reference:
    """What is expected of a match on a plane: a homography and, in `coefficients` (TERMS, 2), a polynomial on top.

    `scale`: the normalisation of camera pixels. `sigma`: scatter around it for weight 1.
    """

    homography: Floats
    scale: Floats
    coefficients: Floats
    sigma: float

    def straight(self, camera_px: Floats) -> Floats:
        """The homography's part, (N, 2)."""
        return mapped(self.homography, camera_px)

    def curved(self, camera_px: Floats) -> Floats:
        """The polynomial's part, (N, 2)."""
        return polynomial_at(self.coefficients, self.scale, camera_px)


def polynomial_at(coefficients: Floats, scale: Floats, camera_px: Floats) -> Floats:
    """Two polynomials (N, 2) by their coefficients (TERMS, 2), at pixels (N, 2) that `scale` (3, 3) normalises."""
    values = np.empty((len(camera_px), 2))
    _evaluate(coefficients, scale, np.ascontiguousarray(camera_px, np.float64), values)
    return values


def slots(labels: Sequence[int]) -> Ints:
    """For each label from 0 to the highest of them its place among them, −1 for the others."""
    slot = np.full(max(labels) + 1, -1, np.int32)
    slot[list(labels)] = np.arange(len(labels))
    return slot


def extents(camera_px: Floats, label: Ints, slot: Ints) -> list[Extent]:
    """Of the matches with each label."""

    def of_piece(at: slice) -> Floats:
        totals = np.tile([0.0, -np.inf, -np.inf, -np.inf, -np.inf], (slot.max() + 1, 1))
        _extend(np.ascontiguousarray(camera_px[at], np.float64), _as_ints(label[at]), slot, totals)
        return totals

    totals = np.stack(in_pieces(len(label), of_piece))
    counts, ends = totals[:, :, 0].sum(axis=0), totals[:, :, 1:].max(axis=0)
    return [Extent(int(count), -end[:2], end[2:]) for count, end in zip(counts, ends, strict=True)]


def sums_over_cells(
    matches: Matches,
    label: Ints,
    slot: Ints,
    references: Sequence[Reference],
    rasters: Sequence[Raster],
    limits: Sequence[float],
    typical_sigma_px: float,
) -> list[Floats]:
    """For each label the sums over its cells, (cells, 7).

    Number of matches, their weight (that of the typical sigma being 1), weighted sums of camera pixels (2) and of
    offsets from the reference's homography (2), weighted sum of squared deviations from homography and polynomial.
    Matches with a larger weighted square than the `limits` are left out.
    """
    first = np.cumsum([0, *(len(raster) for raster in rasters)])
    grids = np.array([[*raster.low, raster.side, raster.columns] for raster in rasters])
    homographies = np.stack([reference.homography for reference in references])
    scales = np.stack([reference.scale for reference in references])
    coefficients = np.stack([reference.coefficients for reference in references])

    def of_piece(at: slice) -> Floats:
        camera_px, projector_px = (
            np.ascontiguousarray(pixels[at], np.float64) for pixels in (matches.camera_px, matches.projector_px)
        )
        weights = np.ones(len(camera_px))
        if matches.sigma_px is not None:
            weights = (typical_sigma_px / matches.sigma_px[at].astype(np.float64)) ** 2
        expected = homographies, scales, coefficients, np.array(limits)
        sums = np.zeros((first[-1], 7))
        _add_up(camera_px, projector_px, weights, _as_ints(label[at]), slot, *expected, grids, first, sums)
        return sums

    sums: Floats = np.sum(in_pieces(len(label), of_piece), axis=0)
    return np.split(sums, first[1:-1])


def _as_ints(label: Ints) -> Ints:
    return np.ascontiguousarray(label, np.int32)


# Matches come in the image's order: long runs of them have one label, and one row.


@compiled
def _end_of_run(label: Ints, start: int) -> int:
    """Where the matches with the label of the one at `start` end."""
    end = start + 1
    while end < len(label) and label[end] == label[start]:
        end += 1
    return end


@compiled
def _plane_of(label: int, slot: Ints) -> int:
    return slot[label] if 0 <= label < len(slot) else -1


@compiled
def _extend(camera_px: Floats, label: Ints, slot: Ints, totals: Floats) -> None:
    """For each label (L, 5): number of matches, the highest of −x, −y, x, y."""
    end = 0
    while end < len(label):
        start, end = end, _end_of_run(label, end)
        plane = _plane_of(label[start], slot)
        if plane < 0:
            continue
        total = totals[plane]
        left, top, right, bottom = total[1], total[2], total[3], total[4]
        for i in range(start, end):
            x, y = camera_px[i, 0], camera_px[i, 1]
            left, right = max(left, -x), max(right, x)
            top, bottom = max(top, -y), max(bottom, y)
        total[0] += end - start
        total[1], total[2], total[3], total[4] = left, top, right, bottom


@compiled
def _add_up(
    camera_px: Floats,
    projector_px: Floats,
    weights: Floats,
    label: Ints,
    slot: Ints,
    homographies: Floats,
    scales: Floats,
    coefficients: Floats,
    limits: Floats,
    grids: Floats,
    first: Ints,
    sums: Floats,
) -> None:
    """Sums (cells, 7); the cells of each plane begin at `first`, `grids`: its left and upper end, side, columns."""
    along = np.empty((_DEGREE + 1, 2))
    end = 0
    while end < len(label):
        start, end = end, _end_of_run(label, end)
        plane = _plane_of(label[start], slot)
        if plane < 0:
            continue
        (h00, h01, h02), (h10, h11, h12), (h20, h21, h22) = homographies[plane]
        (scale, _, shift_x), (_, _, shift_y), _ = scales[plane]
        left, top, side, columns = grids[plane]
        limit, row = limits[plane], np.nan
        for i in range(start, end):
            x, y, weight = camera_px[i, 0], camera_px[i, 1], weights[i]
            if y != row:
                _polynomials_in_x(coefficients[plane], scale * y + shift_y, along)
                row = y
            third = h20 * x + h21 * y + h22
            offset_x = projector_px[i, 0] - (h00 * x + h01 * y + h02) / third
            offset_y = projector_px[i, 1] - (h10 * x + h11 * y + h12) / third
            bent_x, bent_y = _at(along, scale * x + shift_x)
            square = weight * ((offset_x - bent_x) ** 2 + (offset_y - bent_y) ** 2)
            if square <= limit:
                cell = sums[first[plane] + int((y - top) / side) * int(columns) + int((x - left) / side)]
                cell[0] += 1
                cell[1] += weight
                cell[2] += weight * x
                cell[3] += weight * y
                cell[4] += weight * offset_x
                cell[5] += weight * offset_y
                cell[6] += square


@compiled
def _evaluate(coefficients: Floats, scale: Floats, camera_px: Floats, values: Floats) -> None:
    along = np.empty((_DEGREE + 1, 2))
    for i in range(len(camera_px)):
        _polynomials_in_x(coefficients, scale[1, 1] * camera_px[i, 1] + scale[1, 2], along)
        values[i, 0], values[i, 1] = _at(along, scale[0, 0] * camera_px[i, 0] + scale[0, 2])


@compiled
def _at(along: Floats, x: float) -> tuple[float, float]:
    u = v = 0.0
    for degree in range(_DEGREE, -1, -1):
        u, v = u * x + along[degree, 0], v * x + along[degree, 1]
    return u, v


@compiled
def _polynomials_in_x(coefficients: Floats, y: float, along: Floats) -> None:
    """Two polynomials in x and y, at a y, as polynomials in x alone (degrees, 2).

    `coefficients` (TERMS, 2) in the order of `monomials`: x^d, x^(d−1) y, … y^d for each degree d.
    """
    for i in range(_DEGREE + 1):
        u = v = 0.0
        for j in range(_DEGREE - i, -1, -1):
            place = (i + j) * (i + j + 1) // 2 + j
            u, v = u * y + coefficients[place, 0], v * y + coefficients[place, 1]
        along[i, 0], along[i, 1] = u, v
