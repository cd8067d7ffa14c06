"""Dense matches → surfels: small cells of the camera's image, each with an affine map into the projector's image.

A few thousand surfels carry what millions of matches say about planes. Fitting them robustly rejects stray matches,
and cells that straddle the edge of an object.
"""

from dataclasses import dataclass

import numpy as np

from calib.arrays import Floats, Ints
from calib.compiled import compiled
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
# The length of a 2-D normal error has the median 1.177 σ; 3.5 σ is passed by 1 in 450.
_GATE_OF_MEDIAN = 3.5 / 1.177
_SINGULAR = 1e-15
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
        cell = np.empty(len(camera_px), np.int32)
        _cell(np.ascontiguousarray(camera_px), self.side_px, self.columns, self.rows, cell)
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
    camera_px, projector_px = (
        pixels.take(chosen, axis=0).astype(np.float64) for pixels in (matches.camera_px, matches.projector_px)
    )
    order, start = _by_cell(grid.cell(camera_px), grid.rows * grid.columns)
    there = np.minimum(np.diff(start), _MOST_PER_CELL)
    cell = np.flatnonzero(there >= _FEWEST_PER_CELL).astype(np.int32)
    there, picks = there[cell], (rng.random((_TRIALS, 3, len(cell))) * there[cell]).astype(np.int32)
    fits = _Fits(len(cell))
    in_pieces(
        len(cell),
        lambda at: _fit_cells(
            camera_px, projector_px, order, start[cell[at]], there[at], picks[:, :, at], *fits.piece(at)
        ),
        width=_MOST_PER_CELL,
    )
    # Two coordinates per match, six parameters.
    scatter = fits.square / np.maximum(2 * fits.count - 6, 1)
    good = (fits.count >= _FEWEST_PER_CELL) & (fits.count > _FEWEST_INLIERS * there)
    good &= _least_eigenvalue(fits.spread) > fits.count * (grid.side_px / 12) ** 2
    # Matches that scatter more than the cell is wide in the projector are not neighbours there.
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


class _Fits:
    """Affine maps of cells: `value` + `jacobian` · (camera − `mean`), of `count` inliers with that `spread` about the
    mean; `square`: the sum of their squared errors.
    """

    def __init__(self, cells: int) -> None:
        self.mean, self.value = np.empty((cells, 2)), np.empty((cells, 2))
        self.jacobian, self.spread = np.empty((cells, 2, 2)), np.empty((cells, 2, 2))
        self.square, self.count = np.empty(cells), np.empty(cells, np.int32)

    def piece(self, at: slice) -> tuple[Floats, Floats, Floats, Floats, Floats, Ints]:
        """Those of some of the cells, to be filled in."""
        return self.mean[at], self.value[at], self.jacobian[at], self.spread[at], self.square[at], self.count[at]


def _least_eigenvalue(matrices: Floats) -> Floats:
    """Of symmetric matrices (N, 2, 2)."""
    a, b, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    least: Floats = (a + d) / 2 - np.hypot((a - d) / 2, b)
    return least


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


def _by_cell(cell: Ints, cells: int) -> tuple[Ints, Ints]:
    """The matches (N,) cell by cell, in their order, and where each cell starts, (cells + 1,)."""
    start = np.zeros(cells + 1, np.int32)
    np.cumsum(np.bincount(cell, minlength=cells), out=start[1:])
    order = np.empty(len(cell), np.int32)
    _sort(cell, start[:-1].copy(), order)
    return order, start


@compiled
def _cell(camera_px: Floats, side_px: float, columns: int, rows: int, cell: Ints) -> None:
    # Pixel centres are whole numbers: the image begins at −0.5.
    for i in range(len(cell)):
        column, row = int((camera_px[i, 0] + 0.5) / side_px), int((camera_px[i, 1] + 0.5) / side_px)
        cell[i] = min(max(row, 0), rows - 1) * columns + min(max(column, 0), columns - 1)


@compiled
def _sort(cell: Ints, place: Ints, order: Ints) -> None:
    """`place` (cells,): where the next match of each cell goes."""
    for i in range(len(cell)):
        order[place[cell[i]]] = i
        place[cell[i]] += 1


@compiled
def _fit_cells(
    camera_px: Floats,
    projector_px: Floats,
    order: Ints,
    start: Ints,
    there: Ints,
    picks: Ints,
    mean: Floats,
    value: Floats,
    jacobian: Floats,
    spread: Floats,
    square: Floats,
    count: Ints,
) -> None:
    """One cell after the other: `there` matches from `start` in `order` → the map of its inliers, as in `_Fits`."""
    matches, error2 = np.empty((4, _MOST_PER_CELL)), np.empty((2, _MOST_PER_CELL))
    for c in range(len(start)):
        size = there[c]
        x, y, u, v = matches[0, :size], matches[1, :size], matches[2, :size], matches[3, :size]
        for k in range(size):
            match = order[start[c] + k]
            x[k], y[k], u[k], v[k] = (
                camera_px[match, 0],
                camera_px[match, 1],
                projector_px[match, 0],
                projector_px[match, 1],
            )
        best, trial = error2[0, :size], error2[1, :size]
        _best_trial(x, y, u, v, picks[:, :, c], best, trial)
        for _ in range(2):
            gate = _GATE_OF_MEDIAN**2 * _upper_median(best)
            for k in range(size):
                trial[k] = 1.0 if best[k] <= gate else 0.0
            _fit_affine(x, y, u, v, trial, mean[c], value[c], jacobian[c], spread[c])
            _off_affine(x, y, u, v, mean[c], value[c], jacobian[c], best)
        inliers = total = 0.0
        for k in range(size):
            inliers += trial[k]
            total += trial[k] * best[k]
        square[c], count[c] = total, int(inliers)


@compiled
def _best_trial(x: Floats, y: Floats, u: Floats, v: Floats, picks: Ints, best: Floats, trial: Floats) -> None:
    """Squared errors (K,) of the best of the affine maps through three matches each, `picks` (T, 3).

    Best is the least sum of square roots of the errors: robust without a scale that would have to be known.
    """
    lowest = np.inf
    for k in range(len(best)):
        best[k] = np.inf
    for t in range(len(picks)):
        a, b, c = picks[t, 0], picks[t, 1], picks[t, 2]
        bx, by, cx, cy = x[b] - x[a], y[b] - y[a], x[c] - x[a], y[c] - y[a]
        area = bx * cy - by * cx  # zero, and the cost NaN, for three on a line
        u_x = ((u[b] - u[a]) * cy - (u[c] - u[a]) * by) / area
        u_y = ((u[c] - u[a]) * bx - (u[b] - u[a]) * cx) / area
        v_x = ((v[b] - v[a]) * cy - (v[c] - v[a]) * by) / area
        v_y = ((v[c] - v[a]) * bx - (v[b] - v[a]) * cx) / area
        cost = 0.0
        for k in range(len(x)):
            dx, dy = x[k] - x[a], y[k] - y[a]
            off_u, off_v = u[k] - u[a] - u_x * dx - u_y * dy, v[k] - v[a] - v_x * dx - v_y * dy
            trial[k] = off_u * off_u + off_v * off_v
            cost += np.sqrt(np.sqrt(trial[k]))
        if cost < lowest:
            lowest = cost
            for k in range(len(best)):
                best[k] = trial[k]


@compiled
def _upper_median(values: Floats) -> float:
    """The largest of the values that at most half of them are below."""
    median = -np.inf
    for i in range(len(values)):
        below = 0
        for k in range(len(values)):
            below += values[k] < values[i]
        if below <= len(values) // 2 and values[i] > median:
            median = values[i]
    return median


@compiled
def _fit_affine(
    x: Floats,
    y: Floats,
    u: Floats,
    v: Floats,
    weight: Floats,
    mean: Floats,
    value: Floats,
    jacobian: Floats,
    spread: Floats,
) -> None:
    """Least squares over the matches of weight 1: camera mean, projector mean, Jacobian, spread about the mean."""
    count = mean_x = mean_y = mean_u = mean_v = 0.0
    for k in range(len(x)):
        count += weight[k]
        mean_x += weight[k] * x[k]
        mean_y += weight[k] * y[k]
        mean_u += weight[k] * u[k]
        mean_v += weight[k] * v[k]
    mean_x, mean_y, mean_u, mean_v = mean_x / count, mean_y / count, mean_u / count, mean_v / count
    xx = xy = yy = ux = uy = vx = vy = 0.0
    for k in range(len(x)):
        dx, dy = weight[k] * (x[k] - mean_x), weight[k] * (y[k] - mean_y)
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
        ux += dx * (u[k] - mean_u)
        uy += dy * (u[k] - mean_u)
        vx += dx * (v[k] - mean_v)
        vy += dy * (v[k] - mean_v)
    # The pseudo-inverse: matches on a line say nothing about what is across it.
    area = xx * yy - xy * xy
    trace2 = (xx + yy) * (xx + yy)
    across = area > _SINGULAR * trace2
    scale = 1.0 / area if across else (1.0 / trace2 if trace2 > 0.0 else 0.0)
    i_xx, i_xy, i_yy = (yy, -xy, xx) if across else (xx, xy, yy)
    mean[0], mean[1], value[0], value[1] = mean_x, mean_y, mean_u, mean_v
    jacobian[0, 0], jacobian[0, 1] = (ux * i_xx + uy * i_xy) * scale, (ux * i_xy + uy * i_yy) * scale
    jacobian[1, 0], jacobian[1, 1] = (vx * i_xx + vy * i_xy) * scale, (vx * i_xy + vy * i_yy) * scale
    spread[0, 0], spread[0, 1], spread[1, 0], spread[1, 1] = xx, xy, xy, yy


@compiled
def _off_affine(
    x: Floats, y: Floats, u: Floats, v: Floats, mean: Floats, value: Floats, jacobian: Floats, error2: Floats
) -> None:
    """Squared errors (K,) of an affine map."""
    for k in range(len(x)):
        dx, dy = x[k] - mean[0], y[k] - mean[1]
        off_u = u[k] - value[0] - jacobian[0, 0] * dx - jacobian[0, 1] * dy
        off_v = v[k] - value[1] - jacobian[1, 0] * dx - jacobian[1, 1] * dy
        error2[k] = off_u * off_u + off_v * off_v
