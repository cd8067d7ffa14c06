"""A compiled pass over all matches: sums over the image cells of each plane."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry import Matches, mapped
from calib.numerics import Floats, Ints, compiled, in_pieces, monomials

_DEGREE = 4  # `polynomials.DEGREE` as a compile-time constant: twice as fast as a variable


@dataclass(frozen=True)
class Raster:
    """Square cells of `side` pixels from `low` (2,); `columns` × `rows` of them, of which the outer ones reach on."""

    low: Floats
    side: float
    columns: int
    rows: int

    def __len__(self) -> int:
        return self.columns * self.rows


@dataclass(frozen=True)
class Reference:
    """Prediction for a match on a plane: a homography plus a polynomial with `coefficients` (TERMS, 2).

    `scale`: the normalisation of camera pixels. `sigma`: scatter around the prediction for weight 1.
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
        return monomials(camera_px, self.scale) @ self.coefficients


def slots(labels: Sequence[int]) -> Ints:
    """Map each number from 0 to the highest label to its position in `labels`, −1 if it is not one of them."""
    slot = np.full(max(labels) + 1, -1, np.int32)
    slot[list(labels)] = np.arange(len(labels))
    return slot


def sums_over_cells(
    matches: Matches,
    label: Ints,
    slot: Ints,
    references: Sequence[Reference],
    rasters: Sequence[Raster],
    limits: Sequence[float],
    typical_sigma_px: float,
) -> list[Floats]:
    """Return the sums over the cells of each label, (cells, 7).

    The columns are: number of matches, total weight (1 for a match of the typical sigma), weighted sums of camera
    pixels (2) and of deviations from the reference (2), and the weighted sum of their squares. Matches whose weighted
    square exceeds the `limits` are left out.
    """
    first = np.cumsum([0, *(len(raster) for raster in rasters)])
    grids = np.array([[*raster.low, raster.side, raster.columns, raster.rows] for raster in rasters])
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
        sums, labels = np.zeros((first[-1], 7)), np.ascontiguousarray(label[at], np.int32)
        _add_up(camera_px, projector_px, weights, labels, slot, *expected, grids, first, sums)
        return sums

    sums: Floats = np.sum(in_pieces(len(label), of_piece), axis=0)
    return np.split(sums, first[1:-1])


# Matches are in image order: long runs share one label and one row.


@compiled
def _end_of_run(label: Ints, start: int) -> int:
    """Return the end of the run of equal labels that begins at `start`."""
    end = start + 1
    while end < len(label) and label[end] == label[start]:
        end += 1
    return end


@compiled
def _plane_of(label: int, slot: Ints) -> int:
    return slot[label] if 0 <= label < len(slot) else -1


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
    """Sums (cells, 7); the cells of each plane begin at `first`, `grids`: its left and upper end, side, columns,
    rows.
    """
    along = np.empty((_DEGREE + 1, 2))
    end = 0
    while end < len(label):
        start, end = end, _end_of_run(label, end)
        plane = _plane_of(label[start], slot)
        if plane < 0:
            continue
        (h00, h01, h02), (h10, h11, h12), (h20, h21, h22) = homographies[plane]
        (scale, _, shift_x), (_, _, shift_y), _ = scales[plane]
        first_column, top, side, columns, rows = grids[plane]
        limit, row, per_px = limits[plane], np.nan, 1.0 / side
        for i in range(start, end):
            x, y, weight = camera_px[i, 0], camera_px[i, 1], weights[i]
            if y != row:
                _polynomials_in_x(coefficients[plane], scale * y + shift_y, along)
                row = y
            per_third = 1.0 / (h20 * x + h21 * y + h22)
            bent_x, bent_y = _at(along, scale * x + shift_x)
            off_x = projector_px[i, 0] - (h00 * x + h01 * y + h02) * per_third - bent_x
            off_y = projector_px[i, 1] - (h10 * x + h11 * y + h12) * per_third - bent_y
            square = weight * (off_x * off_x + off_y * off_y)
            if square <= limit:
                down = min(max((y - top) * per_px, 0.0), rows - 1.0)
                across = min(max((x - first_column) * per_px, 0.0), columns - 1.0)
                cell = sums[first[plane] + int(down) * int(columns) + int(across)]
                cell[0] += 1
                cell[1] += weight
                cell[2] += weight * x
                cell[3] += weight * y
                cell[4] += weight * off_x
                cell[5] += weight * off_y
                cell[6] += square


@compiled
def _at(along: Floats, x: float) -> tuple[float, float]:
    u = v = 0.0
    for degree in range(_DEGREE, -1, -1):
        u, v = u * x + along[degree, 0], v * x + along[degree, 1]
    return u, v


@compiled
def _polynomials_in_x(coefficients: Floats, y: float, along: Floats) -> None:
    """Reduce two polynomials in x and y to polynomials in x alone, for a given y, (degrees, 2).

    `coefficients` (TERMS, 2) in the order of `monomials`: x^d, x^(d−1) y, … y^d for each degree d.
    """
    for i in range(_DEGREE + 1):
        u = v = 0.0
        for j in range(_DEGREE - i, -1, -1):
            place = (i + j) * (i + j + 1) // 2 + j
            u, v = u * y + coefficients[place, 0], v * y + coefficients[place, 1]
        along[i, 0], along[i, 1] = u, v
