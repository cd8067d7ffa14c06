"""Least-squares planes: through points, robustly, with its covariance; and through the window around every pixel.

In inverse depth a plane n·X = 1 is affine, 1/z = n_x x/z + n_y y/z + n_z, and the noise is uniform. A fit needs the
window's sums of 1, x/z, y/z, 1/z, and of their products. They are updated as running sums along columns and rows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Plane
from calib.numerics import Floats, Ints, biweight, compiled, in_slices, influence_on, robust_covariance

_STEPS = 20
_CONVERGED = 1e-10


@dataclass(frozen=True, eq=False)
class FittedPlane(Plane):
    """A plane that faces the origin, so that its offset is negative, with the covariance of its parameters.

    They are two tilts and a shift around `centre`: the normal becomes `normal` − tilt · `tangents`, and the plane moves
    by the shift along it.
    """

    centre: Floats
    """(3,): the points' weighted mean."""
    tangents: Floats
    """(2, 3): directions in the plane."""
    jacobian: Floats
    """(N, 3): derivatives of the plane's height at each point by the parameters."""
    covariance: Floats
    """(3, 3): of the parameters."""
    residual: Floats
    """(N,): signed distances of the points, positive on the origin's side."""

    @property
    def influence(self) -> Floats:
        """Derivatives (3, N) of the parameters by the points' distances."""
        return influence_on(self.jacobian, self.residual)


def fit_plane(points: Floats, cluster: Ints) -> FittedPlane:
    """Minimise the points' (N, 3) distances from the plane with Tukey's weights.

    `cluster` (N,): labels from 0 of points whose errors may correlate. Raises ValueError for fewer than three points,
    or if they are collinear.
    """
    if len(points) < 3:
        raise ValueError(f"a plane needs three points, found {len(points)}")
    middle, weight, normal = points.mean(axis=0), np.ones(len(points)), np.zeros(3)
    rows = np.ascontiguousarray((points - middle).T)  # (3, N): several times as fast as (N, 3)
    for _ in range(_STEPS):
        centre = rows @ weight / weight.sum()
        from_centre = rows - centre[:, None]
        spread, axes = np.linalg.eigh((weight * from_centre) @ from_centre.T)
        if not spread[1] > 1e-12 * spread[2]:
            raise ValueError("the points are in a line, which many planes go through")
        previous, normal = normal, axes[:, 0]
        residual = normal @ from_centre
        weight = biweight(residual)
        if 1 - abs(previous @ normal) < _CONVERGED**2:
            break
    # In the plane's own axes the height changes by a tilt about either of them, or by a shift.
    jacobian = np.concatenate([axes[:, 1:].T @ from_centre, np.ones((1, len(points)))]).T
    centre += middle
    covariance = robust_covariance(jacobian, residual, cluster)
    offset = float(normal @ centre)
    sign = -1.0 if offset > 0 else 1.0
    return FittedPlane(sign * normal, sign * offset, centre, axes[:, 1:].T, jacobian, covariance, sign * residual)


def dihedral_angle_rad(first: FittedPlane, second: FittedPlane) -> tuple[float, float]:
    """The angle between two faces, on the side of the origin, and its standard deviation, in radians.

    In a room that is the angle of its corner; the angle of a box seen from outside is 2π minus this.
    """
    variance = sum(
        gradient @ plane.covariance @ gradient
        for plane, gradient in zip((first, second), dihedral_gradients(first, second), strict=True)
    )
    cosine = float(np.clip(first.normal @ second.normal, -1, 1))
    return float(np.pi - np.arccos(cosine)), float(np.sqrt(variance))


def dihedral_gradients(first: FittedPlane, second: FittedPlane) -> tuple[Floats, Floats]:
    """Derivatives (3,) of the angle between two faces by the parameters of either."""
    cosine = float(np.clip(first.normal @ second.normal, -1, 1))
    sine = max(float(np.sqrt(1 - cosine**2)), 1e-12)
    by_first, by_second = (
        np.append(-plane.tangents @ neighbour.normal / sine, 0.0)
        for plane, neighbour in ((first, second), (second, first))
    )
    return by_first, by_second


Floats32 = NDArray[np.float32]

LARGEST_WINDOW = 15  # the count of its points fits into a byte
FEWEST_NEIGHBOURS = 4
# Spread of a window's pixels along its narrow side, in px²; a full window has 4, a single row 0.
_NARROWEST = 0.5
# The data of a tile fit into the processor's cache.
_STRIP_ROWS, _TILE_COLUMNS = 64, 256


@dataclass(frozen=True)
class WindowPlanes:
    """`normals` (H, W, 3) and `roughness` (H, W) in footprints, NaN where no plane could be fitted.

    `count` (H, W): number of points in the window of a point, itself included; 0 where there is no point.
    """

    normals: Floats32
    roughness: Floats32
    count: NDArray[np.uint8]


def window_planes(points: Floats32, focal_px: float, window: int) -> WindowPlanes:
    """Planes through windows, odd and at most `LARGEST_WINDOW`, of points (H, W, 3), NaN where there is none."""
    points = np.ascontiguousarray(points)
    height, width = points.shape[:2]
    normals, roughness = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
    count = np.empty((height, width), np.uint8)

    def fit(rows: slice) -> None:
        for first_column in range(0, width, _TILE_COLUMNS):
            right = min(first_column + _TILE_COLUMNS, width)
            _fit_tile(
                points, rows.start, rows.stop, first_column, right, window // 2, focal_px, normals, roughness, count
            )

    in_slices(height, _STRIP_ROWS, fit)
    return WindowPlanes(normals, roughness, count)


@compiled
def _fit_tile(
    points: Floats32,
    top: int,
    bottom: int,
    first_column: int,
    right: int,
    half: int,
    focal_px: float,
    normals: Floats32,
    roughness: Floats32,
    count: NDArray[np.uint8],
) -> None:
    """Compute the arrays of `WindowPlanes` for rows from `top` to `bottom`, columns from `first_column` to `right`."""
    window, width = 2 * half + 1, right - first_column
    terms = np.zeros((window + 1, 4, width + 2 * half))  # of as many rows, in turn; the last stays zero
    sums, totals = np.zeros((10, width + 2 * half)), np.empty((10, width))
    normal = np.empty((3, width))
    for row in range(top - half, bottom + half):
        place = row % window
        entering = terms[place]
        leaving = entering.copy()
        entering[:] = 0.0
        if 0 <= row < len(points):
            _see(points[row], first_column - half, focal_px, entering)
        _slide(sums, entering, leaving)
        y = row - half
        if y >= top:
            _add_along(sums, totals, window)
            centre = terms[y % window]
            here = slice(first_column, right)
            _solve(totals, centre[0, half:], centre[3, half:], focal_px, normal, roughness[y, here], count[y, here])
            _interleave(normal, normals[y, here])


@compiled
def _see(row: Floats32, first_column: int, focal_px: float, terms: Floats) -> None:
    """Compute 1, x/z, y/z in pixels, and 1/z (4, N) of the points from `first_column`; zero for missing points."""
    # Parts are taken out of the arrays before the loop: offsets inside it kept the compiler from vectorising.
    begin, end = max(0, -first_column), min(terms.shape[1], len(row) - first_column)
    points, (ones, x, y, w) = row[first_column + begin : first_column + end], terms[:, begin:end]
    for i in range(len(points)):
        inverse = 1.0 / np.float64(points[i, 2])
        there = np.abs(inverse) < np.inf
        ones[i] = 1.0 if there else 0.0
        x[i] = focal_px * points[i, 0] * inverse if there else 0.0
        y[i] = focal_px * points[i, 1] * inverse if there else 0.0
        w[i] = inverse if there else 0.0


@compiled
def _slide(sums: Floats, entering: Floats, leaving: Floats) -> None:
    """Add the products of one row's terms (4, N) to the sums (10, N), and subtract those of another."""
    number = 0
    for j in range(4):
        for k in range(j, 4):
            products, a, b, c, d = sums[number], entering[j], entering[k], leaving[j], leaving[k]
            for i in range(len(products)):
                products[i] += a[i] * b[i] - c[i] * d[i]
            number += 1


@compiled
def _add_along(sums: Floats, totals: Floats, window: int) -> None:
    """Running sums over `window` neighbours: (10, N + window − 1) → (10, N)."""
    for number in range(0, len(sums), 5):  # five at a time, because each addition depends on the previous one
        a, b, c, d, e = sums[number], sums[number + 1], sums[number + 2], sums[number + 3], sums[number + 4]
        ta, tb, tc, td, te = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(window - 1):
            ta, tb, tc, td, te = ta + a[i], tb + b[i], tc + c[i], td + d[i], te + e[i]
        for i in range(totals.shape[1]):
            j = i + window - 1
            ta, tb, tc, td, te = ta + a[j], tb + b[j], tc + c[j], td + d[j], te + e[j]
            totals[number, i], totals[number + 1, i], totals[number + 2, i] = ta, tb, tc
            totals[number + 3, i], totals[number + 4, i] = td, te
            ta, tb, tc, td, te = ta - a[i], tb - b[i], tc - c[i], td - d[i], te - e[i]


@compiled
def _solve(
    totals: Floats,
    there: Floats,
    inverse_depth: Floats,
    focal_px: float,
    normal: Floats,
    roughness: Floats32,
    count: NDArray[np.uint8],
) -> None:
    """Normals (3, N), roughness and counts (N,) of planes from windows' sums (10, N); `there` (N,): pixels with a
    point.
    """
    normal_x, normal_y, normal_z = normal[0], normal[1], normal[2]
    sum_1, sum_x, sum_y, sum_w, sum_xx = totals[0], totals[1], totals[2], totals[3], totals[4]
    sum_xy, sum_xw, sum_yy, sum_yw, sum_ww = totals[5], totals[6], totals[7], totals[8], totals[9]
    for i in range(len(roughness)):
        share = 1.0 / sum_1[i]
        x, y, w = sum_x[i] * share, sum_y[i] * share, sum_w[i] * share
        xx, xy, yy = sum_xx[i] * share - x * x, sum_xy[i] * share - x * y, sum_yy[i] * share - y * y
        xw, yw, ww = sum_xw[i] * share - x * w, sum_yw[i] * share - y * w, sum_ww[i] * share - w * w
        scale = 1.0 / (xx * yy - xy * xy)
        a, b = (yy * xw - xy * yw) * scale, (xx * yw - xy * xw) * scale
        c = w - a * x - b * y
        # The smaller eigenvalue is larger than this.
        wide = (xx > _NARROWEST) & ((xx - _NARROWEST) * (yy - _NARROWEST) > xy * xy)
        fits = (there[i] > 0.0) & (sum_1[i] > FEWEST_NEIGHBOURS + 0.5) & wide
        length = np.sqrt((a * a + b * b) * focal_px * focal_px + c * c)
        facing = -1.0 / length if fits else np.nan
        normal_x[i] = a * focal_px * facing
        normal_y[i] = b * focal_px * facing
        normal_z[i] = c * facing
        # A depth error of one footprint, z / f, changes 1/z by 1 / (f z).
        rough = np.sqrt(max(ww - a * xw - b * yw, 0.0)) * focal_px / inverse_depth[i]
        roughness[i] = rough if fits else np.nan
        count[i] = np.uint8(np.int32(sum_1[i] * there[i] + 0.5))


@compiled
def _interleave(columns: Floats, rows: Floats32) -> None:
    """Store (3, N) as (N, 3)."""
    x, y, z = columns[0], columns[1], columns[2]
    for i in range(len(rows)):
        rows[i, 0], rows[i, 1], rows[i, 2] = x[i], y[i], z[i]
