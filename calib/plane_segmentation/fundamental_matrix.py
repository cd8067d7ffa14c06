"""Epipolar geometry and lens distortion from surfels, before any plane but the largest is known."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.geometry import homogeneous
from calib.numerics import Floats, Ints, compiled, minimise
from calib.plane_segmentation.plane_parallax import CAMERA_SIGMA, LENS_TERMS, PROJECTOR_SIGMA, Lens, TwoView
from calib.plane_segmentation.surfels import Surfels

_SAMPLES = 400
_SURFELS = 1500
_BLOCK = 100  # surfels after which a candidate may be given up
# Surfels that are off by more lose influence: first in a fit that may still be far out, then in the final one.
_TOLERANCES_PX = (3.0, 0.3)
_PRIOR_SIGMA = np.array([np.inf] * 9 + [*CAMERA_SIGMA, *PROJECTOR_SIGMA])


@dataclass(frozen=True)
class LargestPlane:
    """The homography (3, 3) in ideal coordinates that explains most surfels, the lenses that go with it, and how far
    each surfel (M,) is from what they predict, in projector pixels.
    """

    camera: Lens
    projector: Lens
    homography: Floats
    off_px: Floats


@dataclass(frozen=True)
class _Pairs:
    """Corresponding pixels (N, 2) and what turns them into ideal coordinates."""

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
        """Ideal coordinates (N, 2) in both devices with other lenses (8), and their derivatives (N, 2, 4) by those."""
        trial = self.with_lenses(parameters)
        return *trial.ideal(), trial.camera.jacobian(self.camera_px), trial.projector.jacobian(self.projector_px)


def largest_plane(
    surfels: Surfels, camera_size: tuple[int, int], projector_size: tuple[int, int], rng: np.random.Generator
) -> LargestPlane:
    """Fit one homography and both lenses to as many surfels as possible."""
    chosen = rng.permutation(len(surfels))[:_SURFELS]
    pairs = _Pairs(surfels.camera_px[chosen], surfels.projector_px[chosen], Lens(camera_size), Lens(projector_size))
    start = np.concatenate([_sampled_homography(pairs, rng).ravel(), pairs.lens_parameters])
    for tolerance in _TOLERANCES_PX:
        start, _ = minimise(partial(_plane_residuals, pairs, tolerance), start, _PRIOR_SIGMA)
    everywhere = _Pairs(surfels.camera_px, surfels.projector_px, pairs.camera, pairs.projector)
    residual, _ = _plane_residuals(everywhere, 1.0, start)
    fitted = pairs.with_lenses(start[9:])
    return LargestPlane(fitted.camera, fitted.projector, start[:9].reshape(3, 3), np.linalg.norm(residual, axis=1))


def first_geometry(surfels: Surfels, plane: LargestPlane, rng: np.random.Generator) -> TwoView:
    """The fundamental matrix and both lenses that bring the surfels closest to their epipolar lines.

    Dense matches over a scene with depth determine the radial terms along with it; where they do not, the priors of
    an ordinary lens hold them. Two starts: eight surfels anywhere, and the largest plane with two surfels off it
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
    fits = []
    for pairs, candidates in starts:
        best = candidates[_best_fundamental(candidates, *pairs.ideal())]
        start = np.concatenate([best.ravel(), pairs.lens_parameters])
        fits.append(minimise(partial(_epipolar_residuals, plain, _TOLERANCES_PX[0]), start, _PRIOR_SIGMA))
    nearest = min(fits, key=lambda fit: fit[1])[0]
    found, _ = minimise(partial(_epipolar_residuals, plain, _TOLERANCES_PX[1]), nearest, _PRIOR_SIGMA)
    left, values, right = np.linalg.svd(found[:9].reshape(3, 3))
    epipole = left[:, 2]
    base = np.cross(np.eye(3), epipole) @ (left * [values[0], values[1], 0.0]) @ right
    fitted = plain.with_lenses(found[9:])
    return _balanced(TwoView(fitted.camera, fitted.projector, base, epipole), camera_px, projector_px)


def _plane_residuals(pairs: _Pairs, tolerance_px: float, parameters: Floats) -> tuple[Floats, Floats]:
    """Residuals (N, 2) of a homography (9) and lenses (8), and their Jacobian (N, 2, 17)."""
    residual, jacobian = np.empty((2, len(pairs))).T, np.empty((9 + 2 * LENS_TERMS, 2, len(pairs))).T
    scale = pairs.projector.unit_px / tolerance_px
    _off_homography(*pairs.bent(parameters[9:]), parameters[:9].reshape(3, 3), scale, residual, jacobian)
    return residual, jacobian


def _epipolar_residuals(pairs: _Pairs, tolerance_px: float, parameters: Floats) -> tuple[Floats, Floats]:
    """Distances (N, 1) from the epipolar lines of F (9) with lenses (8), and their Jacobian (N, 1, 17)."""
    residual, jacobian = np.empty((1, len(pairs))).T, np.empty((9 + 2 * LENS_TERMS, 1, len(pairs))).T
    scale = pairs.projector.unit_px / tolerance_px
    _off_epipolar_line(*pairs.bent(parameters[9:]), parameters[:9].reshape(3, 3), scale, residual, jacobian)
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
    best: Floats = candidates[_best_homography(candidates, x, u)]
    return best


def _eight_point_candidates(pairs: _Pairs, rng: np.random.Generator) -> Floats:
    """Fundamental matrices with uᵀ F x = 0 of eight surfels each (Hartley & Zisserman, section 11.2), (S, 3, 3)."""
    x, u = map(homogeneous, pairs.ideal())
    rows = (u[:, :, None] * x[:, None, :]).reshape(len(x), 9)
    left, values, right = np.linalg.svd(_null_vectors(rows[rng.integers(0, len(x), (_SAMPLES, 8))]))
    values[:, 2] = 0.0
    singular: Floats = left @ (values[:, :, None] * right)
    return singular


def _null_vectors(rows: Floats) -> Floats:
    """The matrices (S, 3, 3) whose nine numbers are perpendicular to eight rows each, (S, 8, 9)."""
    # The last column of a complete QR decomposition: a third of the time that singular values take.
    return np.linalg.qr(rows.transpose(0, 2, 1), mode="complete")[0][:, :, 8].reshape(-1, 3, 3)


def _parallax_candidates(pairs: _Pairs, homography: Floats, off_plane: Ints, rng: np.random.Generator) -> Floats:
    """F = [e]× H with e where the parallaxes of two surfels off the plane intersect, (S, 3, 3)."""
    x, u = map(homogeneous, pairs.ideal())
    lines = np.cross((x[off_plane]) @ homography.T, u[off_plane])
    picks = rng.integers(0, len(lines), (_SAMPLES, 2))
    epipoles = np.cross(lines[picks[:, 0]], lines[picks[:, 1]])
    epipoles = epipoles[np.linalg.norm(epipoles, axis=1) > 0]
    candidates: Floats = np.cross(np.eye(3)[None], epipoles[:, None, :]).transpose(0, 2, 1) @ homography
    return candidates


def _balanced(view: TwoView, camera_px: Floats, projector_px: Floats) -> TwoView:
    """The same geometry with A such that the plane nearest to all matches has v = 0: parallaxes are small then."""
    parallax = view.parallax(camera_px, projector_px)
    weight = 1 / parallax.per_px
    for _ in range(10):
        plane = np.asarray(np.linalg.lstsq(parallax.x * weight[:, None], parallax.value * weight)[0], np.float64)
        off = np.abs(parallax.value - parallax.x @ plane) / parallax.per_px
        weight = 1 / (parallax.per_px * np.sqrt(1 + off / (np.median(off) + 1e-12)))
    base = view.homography(plane)
    return TwoView(view.camera, view.projector, base / np.linalg.norm(base), view.epipole)


@compiled
def _best_homography(candidates: Floats, x: Floats, u: Floats) -> int:
    """Which of the candidates (S, 3, 3) has the least Σ √distance over points x, u (N, 2): robust without a scale."""
    best, lowest = 0, np.inf
    for s in range(len(candidates)):
        h, total = candidates[s], 0.0
        for first in range(0, len(x), _BLOCK):
            for i in range(first, min(first + _BLOCK, len(x))):
                third = h[2, 0] * x[i, 0] + h[2, 1] * x[i, 1] + h[2, 2]
                off0 = (h[0, 0] * x[i, 0] + h[0, 1] * x[i, 1] + h[0, 2]) / third - u[i, 0]
                off1 = (h[1, 0] * x[i, 0] + h[1, 1] * x[i, 1] + h[1, 2]) / third - u[i, 1]
                total += np.sqrt(np.sqrt(off0 * off0 + off1 * off1))
            if not total < lowest:
                break
        if total < lowest:
            best, lowest = s, total
    return best


@compiled
def _best_fundamental(candidates: Floats, x: Floats, u: Floats) -> int:
    """Which of the candidates (S, 3, 3) has the least Σ √distance of points u from the epipolar lines of x (N, 2)."""
    best, lowest = 0, np.inf
    for s in range(len(candidates)):
        f, total = candidates[s], 0.0
        for first in range(0, len(x), _BLOCK):
            for i in range(first, min(first + _BLOCK, len(x))):
                a = f[0, 0] * x[i, 0] + f[0, 1] * x[i, 1] + f[0, 2]
                b = f[1, 0] * x[i, 0] + f[1, 1] * x[i, 1] + f[1, 2]
                c = f[2, 0] * x[i, 0] + f[2, 1] * x[i, 1] + f[2, 2]
                total += np.sqrt(np.abs(a * u[i, 0] + b * u[i, 1] + c) / np.sqrt(a * a + b * b))
            if not total < lowest:
                break
        if total < lowest:
            best, lowest = s, total
    return best


@compiled
def _off_homography(
    x: Floats,
    u: Floats,
    x_by_lens: Floats,
    u_by_lens: Floats,
    h: Floats,
    scale: float,
    residual: Floats,
    jacobian: Floats,
) -> None:
    """`residual` (N, 2), `jacobian` (N, 2, 17) of u = H x in units of 1 / `scale`: by H and by both lenses."""
    for i in range(len(x)):
        third = h[2, 0] * x[i, 0] + h[2, 1] * x[i, 1] + h[2, 2]
        per_third = scale / third
        for d in range(2):
            point = (h[d, 0] * x[i, 0] + h[d, 1] * x[i, 1] + h[d, 2]) / third
            residual[i, d] = (point - u[i, d]) * scale
            row = jacobian[i, d]
            for k in range(3):
                by_third = x[i, k] * per_third if k < 2 else per_third
                row[3 * d + k], row[3 - 3 * d + k], row[6 + k] = by_third, 0.0, -point * by_third
            by_x0, by_x1 = (h[d, 0] - point * h[2, 0]) * per_third, (h[d, 1] - point * h[2, 1]) * per_third
            for k in range(4):
                row[9 + k] = by_x0 * x_by_lens[i, 0, k] + by_x1 * x_by_lens[i, 1, k]
                row[13 + k] = -u_by_lens[i, d, k] * scale


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
    """`residual` (N, 1), `jacobian` (N, 1, 17) of u on the line F x in units of 1 / `scale`: by F and both lenses."""
    for i in range(len(x)):
        x0, x1, u0, u1 = x[i, 0], x[i, 1], u[i, 0], u[i, 1]
        a = f[0, 0] * x0 + f[0, 1] * x1 + f[0, 2]
        b = f[1, 0] * x0 + f[1, 1] * x1 + f[1, 2]
        c = f[2, 0] * x0 + f[2, 1] * x1 + f[2, 2]
        per_length = 1.0 / np.sqrt(a * a + b * b)
        a, b = a * per_length, b * per_length
        distance = a * u0 + b * u1 + c * per_length
        residual[i, 0] = distance * scale
        # By the line's three numbers; a distance does not depend on their length.
        by_a, by_b, by_c = (u0 - distance * a) * per_length, (u1 - distance * b) * per_length, per_length
        row = jacobian[i, 0]
        row[0], row[1], row[2] = by_a * x0 * scale, by_a * x1 * scale, by_a * scale
        row[3], row[4], row[5] = by_b * x0 * scale, by_b * x1 * scale, by_b * scale
        row[6], row[7], row[8] = by_c * x0 * scale, by_c * x1 * scale, by_c * scale
        by_x0 = (by_a * f[0, 0] + by_b * f[1, 0] + by_c * f[2, 0]) * scale
        by_x1 = (by_a * f[0, 1] + by_b * f[1, 1] + by_c * f[2, 1]) * scale
        for k in range(4):
            row[9 + k] = by_x0 * x_by_lens[i, 0, k] + by_x1 * x_by_lens[i, 1, k]
            row[13 + k] = (a * u_by_lens[i, 0, k] + b * u_by_lens[i, 1, k]) * scale
