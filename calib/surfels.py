"""Dense matches → surfels: small cells of the camera's image, each with an affine map into the projector's image.

A few thousand surfels carry what millions of matches say about planes. Fitting them robustly rejects stray matches,
and cells that straddle the edge of an object.
"""

from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats, Ints
from calib.matches import Matches
from calib.pieces import in_pieces

_MATCHES_PER_CELL = (20, 40)  # few where there are few matches at all
_WANTED_CELLS = 3000
_MOST_PER_CELL = 64
_FEWEST_PER_CELL = 8
_MOST_CELLS = 9000
_TRIALS = 10
_SAMPLE = 100_000
_FEWEST_INLIERS = 0.6
# How much noisier than usual a cell may be, and what is never too noisy.
_MOST_SCATTER, _ALLOWED_SCATTER_PX = 8.0, 0.1


@dataclass(frozen=True)
class Grid:
    """Square cells of `side_px` over the camera's image, `columns` × `rows` of them."""

    side_px: float
    columns: int
    rows: int

    def cell(self, camera_px: Floats) -> Ints:
        """The cell of each pixel (N, 2) → (N,)."""
        # Pixel centres are whole numbers: the image begins at −0.5.
        column = np.clip((camera_px[:, 0] + 0.5) / self.side_px, 0, self.columns - 1).astype(np.int32)
        row = np.clip((camera_px[:, 1] + 0.5) / self.side_px, 0, self.rows - 1).astype(np.int32)
        cell: Ints = row * np.int32(self.columns) + column
        return cell


@dataclass(frozen=True)
class Surfels:
    """Around `camera_px` (M, 2), projector = `projector_px` (M, 2) + `jacobian` (M, 2, 2) · (camera − `camera_px`).

    `cell` (M,): where on `grid`. `sigma_px` (M,): scatter of a match about the map, in projector pixels. `spread`
    (M, 2, 2): Σ (camera − mean)(camera − mean)ᵀ over the matches behind a surfel, `count` (M,) of them. `tried`: how
    many cells had enough matches.
    """

    grid: Grid
    cell: Ints
    camera_px: Floats
    projector_px: Floats
    jacobian: Floats
    sigma_px: Floats
    spread: Floats
    count: Ints
    tried: int

    def __len__(self) -> int:
        return len(self.cell)


def make_surfels(matches: Matches, camera_size: tuple[int, int], rng: np.random.Generator) -> Surfels:
    """Cells are as small as the density of the matches allows, and so large that there are at most some thousands."""
    grid, density = _choose_grid(matches, camera_size)
    wanted = _MATCHES_PER_CELL[1] / (density * grid.side_px**2)
    chosen = np.arange(len(matches))
    if wanted < 1:
        # One of each so many in a row, for every match to have the same chance.
        steps = np.arange(int(wanted * len(matches)))
        chosen = ((steps + rng.random(len(steps))) / wanted).astype(np.int64)
    cell, members = _members(grid.cell(matches.camera_px[chosen]))
    members = np.where(members >= 0, chosen[members], -1)
    full = np.count_nonzero(members >= 0, axis=1) >= _FEWEST_PER_CELL
    cell, members = cell[full], members[full]

    camera, projector = (pixels[members].astype(np.float64) for pixels in (matches.camera_px, matches.projector_px))
    present = members >= 0
    residual = _best_trial(camera, projector, present, rng)
    for _ in range(2):
        inlier = _inliers(residual, present)
        mean, value, jacobian, spread = _fit_affine(camera, projector, inlier)
        error = projector - value[:, None] - (camera - mean[:, None]) @ jacobian.transpose(0, 2, 1)
        residual = np.hypot(error[..., 0], error[..., 1])
    count = np.count_nonzero(inlier, axis=1)
    # Two coordinates per match, six parameters.
    scatter = np.sum(residual**2 * inlier, axis=1) / np.maximum(2 * count - 6, 1)
    good = (count >= _FEWEST_PER_CELL) & (count > _FEWEST_INLIERS * np.count_nonzero(present, axis=1))
    good &= np.linalg.eigvalsh(spread)[:, 0] > count * (grid.side_px / 12) ** 2
    # Matches that scatter more than the cell is wide in the projector are not neighbours there.
    span = np.einsum("mij,mjk,mik->m", jacobian, spread, jacobian) / (2 * np.maximum(count, 1))
    good &= scatter < span
    # Nor does a cell that straddles an edge have one affine map.
    good &= scatter < _MOST_SCATTER**2 * np.median(scatter) + _ALLOWED_SCATTER_PX**2
    return Surfels(
        grid,
        cell[good],
        mean[good],
        value[good],
        jacobian[good],
        np.sqrt(scatter[good]),
        spread[good],
        count[good].astype(np.int32),
        len(cell),
    )


def _choose_grid(matches: Matches, camera_size: tuple[int, int]) -> tuple[Grid, float]:
    width, height = camera_size
    # Halve the cells until the matches no longer fill them: what is then covered is where there are matches.
    coarse = Grid(max(width, height) / 24, 24, 24)
    some = matches.camera_px[:: max(1, len(matches) // _SAMPLE)]
    covered = np.count_nonzero(np.bincount(coarse.cell(some))) * coarse.side_px**2
    density = len(matches) / covered
    per_cell = np.clip(len(matches) / _WANTED_CELLS, *_MATCHES_PER_CELL)
    side = float(np.sqrt(max(per_cell / density, covered / _MOST_CELLS)))
    return Grid(side, int(np.ceil(width / side)), int(np.ceil(height / side))), density


def _members(cell: Ints) -> tuple[Ints, Ints]:
    """Cells in use (C,), and the matches in each (C, K), filled up with −1."""
    order = np.argsort(cell, kind="stable")
    used, start, count = np.unique(cell[order], return_index=True, return_counts=True)
    rank = np.arange(len(cell)) - np.repeat(start, count)
    row = np.repeat(np.arange(len(used)), count)
    kept = rank < _MOST_PER_CELL
    members = np.full((len(used), min(_MOST_PER_CELL, int(count.max()))), -1)
    members[row[kept], rank[kept]] = order[kept]
    return used.astype(np.int32), members.astype(np.int32)


def _best_trial(camera: Floats, projector: Floats, present: Bools, rng: np.random.Generator) -> Floats:
    """Residuals (C, K) of the best of some affine maps through three random matches of each cell.

    Best is the least sum of square roots of the residuals: robust without a scale that would have to be known.
    """
    last = np.count_nonzero(present, axis=1)
    picks = (rng.random((_TRIALS, 3, len(camera))) * last).astype(np.int32)

    def best_of(at: slice) -> Floats:
        # Coordinate by coordinate: (2, cells, K).
        x, u = (np.moveaxis(pixels[at], -1, 0).copy() for pixels in (camera, projector))
        best, lowest = np.full(x.shape[1:], np.inf), np.full(len(present[at]), np.inf)
        for three in picks[:, :, at]:
            square = _squared_error(x, u, three)
            with np.errstate(invalid="ignore"):  # three matches on a line determine no map
                cost = np.sum(np.sqrt(np.sqrt(square)) * present[at], axis=1)
            better = cost < lowest
            best[better], lowest[better] = square[better], cost[better]
        residual: Floats = np.sqrt(best)
        return residual

    return np.concatenate(in_pieces(len(camera), best_of, width=present.shape[1]))


def _squared_error(x: Floats, u: Floats, three: Ints) -> Floats:
    """Of the affine map through three matches of each cell (3, C), for all of its matches x → u, (2, C, K): (C, K)."""
    cells = np.arange(x.shape[1])
    (a, u_a), *others = ((x[:, cells, pick], u[:, cells, pick]) for pick in three)
    (bx, by), (cx, cy) = (other - a for other, _ in others)
    offset = x - a[:, :, None]
    square = np.zeros(x.shape[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        area = bx * cy - by * cx
        for axis in (0, 1):
            b, c = (image[axis] - u_a[axis] for _, image in others)
            by_x, by_y = (b * cy - c * by) / area, (c * bx - b * cx) / area
            error = u[axis] - u_a[axis][:, None] - by_x[:, None] * offset[0] - by_y[:, None] * offset[1]
            square += error * error
    return square


def _inliers(residual: Floats, present: Bools) -> Bools:
    ordered = np.sort(np.where(present, residual, np.inf), axis=1)
    middle = np.take_along_axis(ordered, np.count_nonzero(present, axis=1)[:, None] // 2, axis=1)
    # The length of a 2-D normal error has the median 1.177 σ; 3.5 σ is passed by 1 in 450.
    inlier: Bools = present & (residual <= 3.5 / 1.177 * middle)
    return inlier


def _fit_affine(camera: Floats, projector: Floats, inlier: Bools) -> tuple[Floats, Floats, Floats, Floats]:
    """Least squares over the inliers of each cell: camera mean, projector mean, Jacobian, spread about the mean."""
    weight = inlier[..., None] / np.maximum(np.count_nonzero(inlier, axis=1), 1)[:, None, None]
    mean, value = np.sum(camera * weight, axis=1), np.sum(projector * weight, axis=1)
    from_mean = (camera - mean[:, None]) * inlier[..., None]
    spread = from_mean.transpose(0, 2, 1) @ from_mean
    cross = (projector - value[:, None]).transpose(0, 2, 1) @ from_mean
    jacobian = cross @ np.linalg.pinv(spread, hermitian=True)
    return mean, value, jacobian, spread
