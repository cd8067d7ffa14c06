"""RANSAC in many small image cells: one affine map from camera to projector per cell."""

from dataclasses import dataclass, fields

import numpy as np

from calib.numerics import MEDIAN_LENGTH, Floats, Ints, compiled, in_pieces

MOST_PER_CELL = 64
_GATE_SIGMAS = 3.5  # passed by one in 450 of the lengths of 2-D normal errors
_SINGULAR = 1e-15


@dataclass(frozen=True)
class CellFits:
    """Affine maps of C cells: projector = `value` (C, 2) + `jacobian` (C, 2, 2) · (camera − `mean` (C, 2)).

    `count` (C,): number of inliers. `spread` (C, 2, 2): Σ (camera − mean)(camera − mean)ᵀ over them. `square` (C,):
    their sum of squared errors.
    """

    mean: Floats
    value: Floats
    jacobian: Floats
    spread: Floats
    square: Floats
    count: Ints


def fit_cells(camera_px: Floats, projector_px: Floats, order: Ints, start: Ints, there: Ints, picks: Ints) -> CellFits:
    """Fit each cell of all matches (N, 2); a cell has `there` (C,) matches with indices at `order[start:]`.

    Maps through three matches each, `picks` (T, 3, C), are tried first; the best is then refitted twice to its inliers
    by least squares.
    """
    cells, gate = len(start), (_GATE_SIGMAS / MEDIAN_LENGTH) ** 2
    two, four = (cells, 2), (cells, 2, 2)
    fits = CellFits(
        np.empty(two), np.empty(two), np.empty(four), np.empty(four), np.empty(cells), np.empty(cells, np.int32)
    )

    def fit(at: slice) -> None:
        values = (getattr(fits, field.name)[at] for field in fields(fits))
        _fit_cells(
            camera_px, projector_px, order, start[at], there[at], np.ascontiguousarray(picks[:, :, at]), gate, *values
        )

    in_pieces(cells, fit, width=MOST_PER_CELL)
    return fits


@compiled
def _fit_cells(
    camera_px: Floats,
    projector_px: Floats,
    order: Ints,
    start: Ints,
    there: Ints,
    picks: Ints,
    gate: float,
    mean: Floats,
    value: Floats,
    jacobian: Floats,
    spread: Floats,
    square: Floats,
    count: Ints,
) -> None:
    """Fit each cell's `there` matches from `start` in `order` to the map of their inliers, as in `CellFits`.

    `gate`: largest squared error of an inlier, in medians.
    """
    matches, error2 = np.empty((4, MOST_PER_CELL)), np.empty((2, MOST_PER_CELL))
    for c in range(len(start)):
        size = there[c]
        x, y, u, v = matches[0, :size], matches[1, :size], matches[2, :size], matches[3, :size]
        for k in range(size):
            match = order[start[c] + k]
            x[k], y[k] = camera_px[match, 0], camera_px[match, 1]
            u[k], v[k] = projector_px[match, 0], projector_px[match, 1]
        best, trial = error2[0, :size], error2[1, :size]
        _best_trial(x, y, u, v, picks[:, :, c], best, trial)
        for _ in range(2):
            limit = gate * _upper_median(best)
            for k in range(size):
                trial[k] = 1.0 if best[k] <= limit else 0.0
            _fit_affine(x, y, u, v, trial, mean[c], value[c], jacobian[c], spread[c])
            _off_affine(x, y, u, v, mean[c], value[c], jacobian[c], best)
        inliers = total = 0.0
        for k in range(size):
            inliers += trial[k]
            total += trial[k] * best[k]
        square[c], count[c] = total, int(inliers)


@compiled
def _best_trial(x: Floats, y: Floats, u: Floats, v: Floats, picks: Ints, best: Floats, trial: Floats) -> None:
    """Fill in the squared errors (K,) of the best affine map through three matches each, `picks` (T, 3).

    The best map has the least sum of square roots of the errors: robust, and needs no known scale.
    """
    lowest = np.inf
    for k in range(len(best)):
        best[k] = np.inf
    for t in range(len(picks)):
        a, b, c = picks[t, 0], picks[t, 1], picks[t, 2]
        bx, by, cx, cy = x[b] - x[a], y[b] - y[a], x[c] - x[a], y[c] - y[a]
        area = bx * cy - by * cx  # zero for three collinear matches; the cost is then NaN
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
    # The pseudo-inverse: collinear matches do not determine the slope across their line.
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
