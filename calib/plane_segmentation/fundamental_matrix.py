"""Estimate epipolar geometry and lens distortion from surfels, when only the largest plane is known."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.geometry import cross_matrix, homogeneous
from calib.numerics import Floats, Ints, Minimum, compiled, fit_reweighted, in_parallel, minimise
from calib.plane_segmentation.plane_parallax import CAMERA_SIGMA, LENS_TERMS, PROJECTOR_SIGMA, Lens, TwoView
from calib.plane_segmentation.surfels import Surfels

_SAMPLES = 400
_SURFELS = 1500
_BALANCING_ROUNDS = 10
_BLOCK = 100  # surfels after which a candidate may be given up
# Surfels with larger residuals lose influence: first in a fit that may still be far off, then in the final one.
_TOLERANCES_PX = (3.0, 0.3)
_PRIOR_SIGMA = np.array([*CAMERA_SIGMA, *PROJECTOR_SIGMA] + [np.inf] * 9)


@dataclass(frozen=True)
class LargestPlane:
    """The homography (3, 3) in ideal coordinates that explains most surfels, its lenses, and the residual of each
    surfel (M,) in projector pixels.
    """

    camera: Lens
    projector: Lens
    homography: Floats
    off_px: Floats


@dataclass(frozen=True)
class _Pairs:
    """Corresponding pixels (N, 2) and the lenses that map them to ideal coordinates."""

    camera_px: Floats
    projector_px: Floats
    camera: Lens
    projector: Lens

    def with_lenses(self, parameters: Floats) -> "_Pairs":
        return _Pairs(
            self.camera_px,
            self.projector_px,
            self.camera.with_parameters(parameters[:LENS_TERMS]),
            self.projector.with_parameters(parameters[LENS_TERMS:]),
        )

    @property
    def lens_parameters(self) -> Floats:
        return np.concatenate([self.camera.parameters, self.projector.parameters])

    def __len__(self) -> int:
        return len(self.camera_px)

    def ideal(self) -> tuple[Floats, Floats]:
        """Ideal coordinates in both devices, (N, 2) each."""
        return self.camera.ideal(self.camera_px), self.projector.ideal(self.projector_px)

    def bent(self, parameters: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return ideal coordinates (N, 2) in both devices for lens parameters (8), and their derivatives (N, 2, 4)."""
        trial = self.with_lenses(parameters)
        return *trial.ideal(), trial.camera.jacobian(self.camera_px), trial.projector.jacobian(self.projector_px)


def largest_plane(
    surfels: Surfels, camera_size: tuple[int, int], projector_size: tuple[int, int], rng: np.random.Generator
) -> LargestPlane:
    """Fit one homography and both lenses to as many surfels as possible."""
    chosen = rng.permutation(len(surfels))[:_SURFELS]
    pairs = _Pairs(surfels.camera_px[chosen], surfels.projector_px[chosen], Lens(camera_size), Lens(projector_size))
    start = np.concatenate([pairs.lens_parameters, _sampled_homography(pairs, rng).ravel()])
    for tolerance in _TOLERANCES_PX:
        start = minimise(partial(_plane_residuals, pairs, tolerance), start, _PRIOR_SIGMA).parameters
    everywhere = _Pairs(surfels.camera_px, surfels.projector_px, pairs.camera, pairs.projector)
    residual, _ = _plane_residuals(everywhere, 1.0, start)
    fitted = pairs.with_lenses(start[:8])
    return LargestPlane(fitted.camera, fitted.projector, start[8:].reshape(3, 3), np.linalg.norm(residual, axis=1))


def first_geometry(surfels: Surfels, plane: LargestPlane, rng: np.random.Generator) -> TwoView:
    """Estimate the fundamental matrix and both lenses that minimise the distances of surfels from epipolar lines.

    Dense matches over a scene with depth also determine the radial terms; otherwise the priors of an ordinary lens
    constrain them. There are two kinds of start: eight surfels anywhere, and the largest plane with two surfels off it
    (Hartley & Zisserman, 2nd ed., algorithm 13.2), which finds a small box on a large floor.
    """
    chosen = rng.permutation(len(surfels))[:_SURFELS]
    camera_px, projector_px = surfels.camera_px[chosen], surfels.projector_px[chosen]
    plain = _Pairs(camera_px, projector_px, Lens(plane.camera.size_px), Lens(plane.projector.size_px))
    corrected = _Pairs(camera_px, projector_px, plane.camera, plane.projector)
    starts = [(plain, _eight_point_candidates(plain, rng))]
    off_plane = np.flatnonzero(plane.off_px[chosen] > _TOLERANCES_PX[0]).astype(np.int32)
    if len(off_plane) >= 8:
        starts.append((corrected, _parallax_candidates(corrected, plane.homography, off_plane, rng)))

    def fitted_from(pairs: _Pairs, candidates: Floats) -> Minimum:
        best = candidates[_best_candidate(candidates, *pairs.ideal(), True)]
        start = np.concatenate([pairs.lens_parameters, best.ravel()])
        return minimise(partial(_epipolar_residuals, plain, _TOLERANCES_PX[0]), start, _PRIOR_SIGMA)

    fits = in_parallel(lambda start: fitted_from(*start), starts)
    nearest = min(fits, key=lambda fit: fit.cost).parameters
    parameters = minimise(partial(_epipolar_residuals, plain, _TOLERANCES_PX[1]), nearest, _PRIOR_SIGMA).parameters
    left_vectors, values, right = np.linalg.svd(parameters[8:].reshape(3, 3))
    epipole = left_vectors[:, 2]
    base = cross_matrix(epipole) @ (left_vectors * [values[0], values[1], 0.0]) @ right
    fitted = plain.with_lenses(parameters[:8])
    return _balanced(TwoView(fitted.camera, fitted.projector, base, epipole), camera_px, projector_px)


def _plane_residuals(pairs: _Pairs, tolerance_px: float, parameters: Floats) -> tuple[Floats, Floats]:
    """Residuals (N, 2) of lenses (8) and a homography (9), and their Jacobian (N, 2, 17)."""
    residual, jacobian = np.empty((2, len(pairs))).T, np.empty((9 + 2 * LENS_TERMS, 2, len(pairs))).T
    scale = pairs.projector.unit_px / tolerance_px
    homography, label = parameters[8:].reshape(1, 3, 3), np.zeros(len(pairs), np.int32)
    off_homographies(*pairs.bent(parameters[:8]), homography, label, scale, residual, jacobian)
    return residual, jacobian


def _epipolar_residuals(pairs: _Pairs, tolerance_px: float, parameters: Floats) -> tuple[Floats, Floats]:
    """Return distances (N, 1) from the epipolar lines for lenses (8) and F (9), and their Jacobian (N, 1, 17)."""
    residual, jacobian = np.empty((1, len(pairs))).T, np.empty((9 + 2 * LENS_TERMS, 1, len(pairs))).T
    scale = pairs.projector.unit_px / tolerance_px
    _off_epipolar_line(*pairs.bent(parameters[:8]), parameters[8:].reshape(3, 3), scale, residual, jacobian)
    return residual, jacobian


def _sampled_homography(pairs: _Pairs, rng: np.random.Generator) -> Floats:
    """The best of many homographies through four surfels each."""
    x, u = pairs.ideal()
    picks = rng.integers(0, len(x), (_SAMPLES, 4))
    xs, us, zero = homogeneous(x[picks]), u[picks], np.zeros((_SAMPLES, 4, 3))
    rows = np.concatenate(
        [
            np.concatenate([xs, zero, -us[..., :1] * xs], axis=2),
            np.concatenate([zero, xs, -us[..., 1:] * xs], axis=2),
        ],
        axis=1,
    )
    candidates = _null_vectors(rows)
    best: Floats = candidates[_best_candidate(candidates, x, u, False)]
    return best


def _eight_point_candidates(pairs: _Pairs, rng: np.random.Generator) -> Floats:
    """Solve uᵀ F x = 0 for eight surfels each (Hartley & Zisserman, section 11.2), (S, 3, 3)."""
    x, u = map(homogeneous, pairs.ideal())
    rows = (u[:, :, None] * x[:, None, :]).reshape(len(x), 9)
    left_vectors, values, right = np.linalg.svd(_null_vectors(rows[rng.integers(0, len(x), (_SAMPLES, 8))]))
    values[:, 2] = 0.0
    singular: Floats = left_vectors @ (values[:, :, None] * right)
    return singular


def _null_vectors(rows: Floats) -> Floats:
    """The matrices (S, 3, 3) whose nine numbers are perpendicular to eight rows each, (S, 8, 9)."""
    # The last column of a complete QR decomposition: takes a third of the time of an SVD.
    return np.linalg.qr(rows.transpose(0, 2, 1), mode="complete")[0][:, :, 8].reshape(-1, 3, 3)


def _parallax_candidates(pairs: _Pairs, homography: Floats, off_plane: Ints, rng: np.random.Generator) -> Floats:
    """Return F = [e]× H (S, 3, 3), with e at the intersection of the parallax lines of two surfels off the plane."""
    x, u = map(homogeneous, pairs.ideal())
    lines = np.cross((x[off_plane]) @ homography.T, u[off_plane])
    picks = rng.integers(0, len(lines), (_SAMPLES, 2))
    epipoles = np.cross(lines[picks[:, 0]], lines[picks[:, 1]])
    epipoles = epipoles[np.linalg.norm(epipoles, axis=1) > 0]
    return -cross_matrix(epipoles) @ homography


def _balanced(view: TwoView, camera_px: Floats, projector_px: Floats) -> TwoView:
    """Change the gauge so that the plane nearest to all matches has v = 0, which keeps parallaxes small."""
    parallax = view.parallax(camera_px, projector_px)

    def weigh(off_px: Floats) -> Floats:
        weight: Floats = 1 / (1 + np.abs(off_px) / (np.median(np.abs(off_px)) + 1e-12))
        return weight

    in_px = parallax.x.T / parallax.per_px
    start = np.ones(len(parallax.value))
    plane = fit_reweighted(in_px, parallax.value / parallax.per_px, weigh, start, _BALANCING_ROUNDS)
    base = view.homography(plane)
    return TwoView(view.camera, view.projector, base / np.linalg.norm(base), view.epipole)


@compiled
def _distance(m: Floats, x0: float, x1: float, u0: float, u1: float, to_line: bool) -> float:
    """Return the distance of u from the point m x, or from the line m x."""
    a = m[0, 0] * x0 + m[0, 1] * x1 + m[0, 2]
    b = m[1, 0] * x0 + m[1, 1] * x1 + m[1, 2]
    c = m[2, 0] * x0 + m[2, 1] * x1 + m[2, 2]
    distance: float = np.abs(a * u0 + b * u1 + c) / np.sqrt(a * a + b * b)
    if not to_line:
        distance = np.sqrt((a / c - u0) ** 2 + (b / c - u1) ** 2)
    return distance


@compiled
def _best_candidate(candidates: Floats, x: Floats, u: Floats, to_lines: bool) -> int:
    """Select the homography (S, 3, 3), or fundamental matrix if `to_lines`, with the least Σ √distance over points x, u
    (N, 2): a consensus without a scale.
    """
    best, lowest = 0, np.inf
    for s in range(len(candidates)):
        candidate, total = candidates[s], 0.0
        for first in range(0, len(x), _BLOCK):
            for i in range(first, min(first + _BLOCK, len(x))):
                total += np.sqrt(_distance(candidate, x[i, 0], x[i, 1], u[i, 0], u[i, 1], to_lines))
            if not total < lowest:
                break
        if total < lowest:
            best, lowest = s, total
    return best


@compiled
def off_homographies(
    x: Floats,
    u: Floats,
    x_by_lens: Floats,
    u_by_lens: Floats,
    homographies: Floats,
    label: Ints,
    scale: float,
    residual: Floats,
    jacobian: Floats,
) -> None:
    """Fill in the `residual` (N, 2) of u = H x in units of 1 / `scale`, H being the homography (n, 3, 3) of the label,
    and the first columns of its `jacobian` (N, 2, 17 or more): by both lenses (8), then by H (9), row by row.
    """
    for i in range(len(x)):
        h = homographies[label[i]]
        third = h[2, 0] * x[i, 0] + h[2, 1] * x[i, 1] + h[2, 2]
        per_third = scale / third
        for d in range(2):
            point = (h[d, 0] * x[i, 0] + h[d, 1] * x[i, 1] + h[d, 2]) / third
            residual[i, d] = (point - u[i, d]) * scale
            row = jacobian[i, d]
            by_x0, by_x1 = (h[d, 0] - point * h[2, 0]) * per_third, (h[d, 1] - point * h[2, 1]) * per_third
            for k in range(4):
                row[k] = by_x0 * x_by_lens[i, 0, k] + by_x1 * x_by_lens[i, 1, k]
                row[4 + k] = -u_by_lens[i, d, k] * scale
            for k in range(3):
                by_third = x[i, k] * per_third if k < 2 else per_third
                row[8 + 3 * d + k], row[11 - 3 * d + k], row[14 + k] = by_third, 0.0, -point * by_third


@compiled
def _off_epipolar_line(
    x: Floats,
    u: Floats,
    x_by_lens: Floats,
    u_by_lens: Floats,
    f: Floats,
    scale: float,
    residual: Floats,
    jacobian: Floats,
) -> None:
    """Fill in `residual` (N, 1), distance of u from the line F x in units of 1 / `scale`, and `jacobian` (N, 1, 17)."""
    for i in range(len(x)):
        x0, x1, u0, u1 = x[i, 0], x[i, 1], u[i, 0], u[i, 1]
        a = f[0, 0] * x0 + f[0, 1] * x1 + f[0, 2]
        b = f[1, 0] * x0 + f[1, 1] * x1 + f[1, 2]
        c = f[2, 0] * x0 + f[2, 1] * x1 + f[2, 2]
        per_length = 1.0 / np.sqrt(a * a + b * b)
        a, b = a * per_length, b * per_length
        distance = a * u0 + b * u1 + c * per_length
        residual[i, 0] = distance * scale
        # Derivative by the line's three coefficients; the distance does not depend on their norm.
        by_a, by_b, by_c = (u0 - distance * a) * per_length, (u1 - distance * b) * per_length, per_length
        row = jacobian[i, 0]
        for k, by_line in enumerate((by_a, by_b, by_c)):
            row[8 + 3 * k], row[9 + 3 * k], row[10 + 3 * k] = (
                by_line * x0 * scale,
                by_line * x1 * scale,
                by_line * scale,
            )
        by_x0 = (by_a * f[0, 0] + by_b * f[1, 0] + by_c * f[2, 0]) * scale
        by_x1 = (by_a * f[0, 1] + by_b * f[1, 1] + by_c * f[2, 1]) * scale
        for k in range(4):
            row[k] = by_x0 * x_by_lens[i, 0, k] + by_x1 * x_by_lens[i, 1, k]
            row[4 + k] = (a * u_by_lens[i, 0, k] + b * u_by_lens[i, 1, k]) * scale
