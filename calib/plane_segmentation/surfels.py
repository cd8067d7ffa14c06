"""Dense matches → surfels: small cells of the camera's image, each with an affine map into the projector's image; and
what they observe of planes, given the epipolar geometry: a parallax and its gradient in the image.

A few thousand surfels carry the information of millions of matches about planes. Fitting them robustly rejects outliers
and cells that straddle the edge of an object.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Matches
from calib.numerics import Floats, Ints, compiled, in_parallel
from calib.plane_segmentation.affine_ransac import MOST_PER_CELL, fit_cells
from calib.plane_segmentation.plane_parallax import TwoView

_MATCHES_PER_CELL = (20, 40)  # few where there are few matches at all
_WANTED_CELLS = 3000
_FEWEST_PER_CELL = 8
_MOST_CELLS = 6000
_TRIALS = 10
_SAMPLE = 100_000
_FEWEST_INLIERS = 0.6
# Largest noise of a cell relative to the typical one, and noise that is always accepted.
_MOST_SCATTER, _ALLOWED_SCATTER_PX = 8.0, 0.1


@dataclass(frozen=True)
class Grid:
    """Square cells of `side_px` over the camera's image, `columns` × `rows` of them."""

    side_px: float
    columns: int
    rows: int

    def cell(self, camera_px: Floats) -> Ints:
        """The cell of each pixel (N, 2) → (N,)."""
        cell = np.empty(len(camera_px), np.int32)
        _cell(np.ascontiguousarray(camera_px), self.side_px, self.columns, self.rows, cell)
        return cell


@dataclass(frozen=True)
class Surfels:
    """Local affine maps of cells: around `camera_px`, projector = `projector_px` + `jacobian` · (camera −
    `camera_px`).
    """

    grid: Grid
    cell: Ints
    """Where on `grid`, (M,)."""
    camera_px: Floats
    """(M, 2)."""
    projector_px: Floats
    """(M, 2)."""
    jacobian: Floats
    """(M, 2, 2)."""
    sigma_px: Floats
    """Scatter of a match about the map, in projector pixels, (M,)."""
    spread: Floats
    """Σ (camera − mean)(camera − mean)ᵀ over the matches behind a surfel, (M, 2, 2)."""
    count: Ints
    """Number of these matches, (M,)."""
    tried: int
    """How many cells had enough matches."""

    def __len__(self) -> int:
        return len(self.cell)


def make_surfels(matches: Matches, camera_size: tuple[int, int], rng: np.random.Generator) -> Surfels:
    """Fit surfels in cells as small as the density of matches allows, but at most a few thousand of them."""
    grid, density = _choose_grid(matches, camera_size)
    wanted = _MATCHES_PER_CELL[1] / (density * grid.side_px**2)
    camera_px, projector_px = matches.camera_px, matches.projector_px
    if wanted < 1:
        # Take one of every few consecutive matches, so that all have the same chance.
        steps = np.arange(int(wanted * len(matches)))
        chosen = ((steps + rng.random(len(steps))) / wanted).astype(np.int64)
        camera_px, projector_px = in_parallel(lambda px: px.take(chosen, axis=0), (camera_px, projector_px))
    camera_px, projector_px = (np.ascontiguousarray(px, np.float64) for px in (camera_px, projector_px))
    order, start = _by_cell(grid.cell(camera_px), grid.rows * grid.columns)
    there = np.minimum(np.diff(start), MOST_PER_CELL)
    cell = np.flatnonzero(there >= _FEWEST_PER_CELL).astype(np.int32)
    there, picks = there[cell], (rng.random((_TRIALS, 3, len(cell))) * there[cell]).astype(np.int32)
    fits = fit_cells(camera_px, projector_px, order, start[cell], there, picks)
    # Two coordinates per match, six parameters.
    scatter = fits.square / np.maximum(2 * fits.count - 6, 1)
    good = (fits.count >= _FEWEST_PER_CELL) & (fits.count > _FEWEST_INLIERS * there)
    good &= _least_eigenvalue(fits.spread) > fits.count * (grid.side_px / 12) ** 2
    # Matches that scatter more than the cell's width in the projector are not neighbours there.
    span = np.einsum("mij,mjk,mik->m", fits.jacobian, fits.spread, fits.jacobian) / (2 * np.maximum(fits.count, 1))
    good &= scatter < span
    # Nor does a cell that straddles an edge have one affine map.
    good &= scatter < _MOST_SCATTER**2 * np.median(scatter) + _ALLOWED_SCATTER_PX**2
    return Surfels(
        grid,
        cell[good],
        fits.mean[good],
        fits.value[good],
        fits.jacobian[good],
        np.sqrt(scatter[good]),
        fits.spread[good],
        fits.count[good],
        len(cell),
    )


def _least_eigenvalue(matrices: Floats) -> Floats:
    """Return the smaller eigenvalue of symmetric matrices (N, 2, 2)."""
    a, b, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    return (a + d) / 2 - np.hypot((a - d) / 2, b)


def _choose_grid(matches: Matches, camera_size: tuple[int, int]) -> tuple[Grid, float]:
    width, height = camera_size
    # Halve the cells until the matches no longer fill them: then the occupied cells cover the matches.
    coarse = Grid(max(width, height) / 24, 24, 24)
    some = matches.camera_px[:: max(1, len(matches) // _SAMPLE)]
    covered = np.count_nonzero(np.bincount(coarse.cell(some))) * coarse.side_px**2
    density = len(matches) / covered
    per_cell = np.clip(len(matches) / _WANTED_CELLS, *_MATCHES_PER_CELL)
    side = float(np.sqrt(max(per_cell / density, covered / _MOST_CELLS)))
    return Grid(side, int(np.ceil(width / side)), int(np.ceil(height / side))), density


def _by_cell(cell: Ints, cells: int) -> tuple[Ints, Ints]:
    """Return the matches (N,) sorted by cell, in stable order, and the start of each cell (cells + 1,)."""
    start = np.zeros(cells + 1, np.int32)
    np.cumsum(np.bincount(cell, minlength=cells), out=start[1:])
    order = np.empty(len(cell), np.int32)
    _sort(cell, start[:-1].copy(), order)
    return order, start


@compiled
def _cell(camera_px: Floats, side_px: float, columns: int, rows: int, cell: Ints) -> None:
    per_px = 1.0 / side_px
    # Pixel centres are whole numbers: the image begins at −0.5.
    for i in range(len(cell)):
        column, row = int((camera_px[i, 0] + 0.5) * per_px), int((camera_px[i, 1] + 0.5) * per_px)
        cell[i] = min(max(row, 0), rows - 1) * columns + min(max(column, 0), columns - 1)


@compiled
def _sort(cell: Ints, place: Ints, order: Ints) -> None:
    """Sort matches by cell; `place` (cells,): position of the next match of each cell."""
    for i in range(len(cell)):
        order[place[cell[i]]] = i
        place[cell[i]] += 1


@dataclass(frozen=True)
class SurfelEquations:
    """Linear equations of each surfel for the plane v (3,) it lies on, in units of their standard deviations.

    `rows` (12, M): three equations, each a right-hand side followed by the three coefficients of v: first for the
    parallax, then for its slopes along both camera axes. `sigma` (M,): of the parallax, in projector pixels. `across`
    (M,): distance from the epipolar line over `sigma`.
    """

    rows: Floats
    sigma: Floats
    across: Floats

    def off(self, planes: Floats, number: int = 0) -> Floats:
        """Return the residual of one of the three equations for planes (n, 3), (n, M)."""
        off: Floats = self.rows[4 * number] - planes @ self.rows[4 * number + 1 : 4 * number + 4]
        return off

    def off_own(self, planes: Floats, label: Ints) -> Floats:
        """Return the residual (M,) of the parallax for each surfel's own plane, given by `label` (M,)."""
        off: Floats = self.rows[0] - np.einsum("im,mi->m", self.rows[1:4], planes[label])
        return off


def gather_evidence(surfels: Surfels, view: TwoView, model_px: float) -> SurfelEquations:
    """Gather the equations; `model_px`: standard deviation of errors of the lens model and the decoder."""
    step = surfels.grid.side_px / 2
    here = view.parallax(surfels.camera_px, surfels.projector_px)
    sigma = np.hypot(surfels.sigma_px / np.sqrt(surfels.count), model_px)
    rows = np.empty((12, len(surfels)))
    rows[0], rows[1:4] = here.value, here.x.T
    rows[:4] /= here.per_px * sigma
    spread = surfels.spread
    determinant = spread[:, 0, 0] * spread[:, 1, 1] - spread[:, 0, 1] ** 2
    for axis in (0, 1):
        shift = step * np.eye(2)[axis]
        moved = surfels.jacobian @ shift
        ahead = view.parallax(surfels.camera_px + shift, surfels.projector_px + moved)
        behind = view.parallax(surfels.camera_px - shift, surfels.projector_px - moved)
        variance = spread[:, 1 - axis, 1 - axis] / determinant * surfels.sigma_px**2
        # A model error that varies over a few cells also has a slope.
        slope_sigma = np.sqrt(variance + (model_px / (4 * step)) ** 2)
        slope = rows[4 + 4 * axis : 8 + 4 * axis]
        slope[0], slope[1:] = ahead.value - behind.value, (ahead.x - behind.x).T
        slope /= 2 * step * here.per_px * slope_sigma
    return SurfelEquations(rows, sigma, here.across_px / sigma)
