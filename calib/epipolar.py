"""Epipolar geometry and lens distortion from surfels, before any plane but the largest is known."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.arrays import Floats, Ints
from calib.homography import homogeneous
from calib.robust import minimise
from calib.surfels import Surfels
from calib.two_view import CAMERA_SIGMA, LENS_TERMS, PROJECTOR_SIGMA, Lens, TwoView

_SAMPLES = 400
_SURFELS = 1500
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

    def ideal(self) -> tuple[Floats, Floats]:
        """Homogeneous ideal coordinates in both devices, (N, 3) each."""
        return homogeneous(self.camera.ideal(self.camera_px)), homogeneous(self.projector.ideal(self.projector_px))


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
        found = np.concatenate([_best_candidate(pairs, candidates).ravel(), pairs.lens_parameters])
        for tolerance in _TOLERANCES_PX:
            found, cost = minimise(partial(_epipolar_residuals, plain, tolerance), found, _PRIOR_SIGMA)
        fits.append((cost, found))
    found = min(fits, key=lambda fit: fit[0])[1]
    left, values, right = np.linalg.svd(found[:9].reshape(3, 3))
    epipole = left[:, 2]
    base = np.cross(np.eye(3), epipole) @ (left * [values[0], values[1], 0.0]) @ right
    fitted = plain.with_lenses(found[9:])
    return _balanced(TwoView(fitted.camera, fitted.projector, base, epipole), camera_px, projector_px)


def _plane_residuals(pairs: _Pairs, tolerance_px: float, parameters: Floats) -> tuple[Floats, Floats]:
    """Residuals (N, 2) of a homography (9) and lenses (8), and their Jacobian (N, 2, 17)."""
    trial, homography = pairs.with_lenses(parameters[9:]), parameters[:9].reshape(3, 3)
    x, u = trial.ideal()
    predicted = x @ homography.T
    point = predicted[:, :2] / predicted[:, 2:]
    by_predicted = np.concatenate([np.broadcast_to(np.eye(2), (len(x), 2, 2)), -point[:, :, None]], axis=2)
    by_predicted = by_predicted / predicted[:, 2, None, None]
    jacobian = np.concatenate(
        [
            (by_predicted[:, :, :, None] * x[:, None, None, :]).reshape(-1, 2, 9),
            (by_predicted @ homography)[:, :, :2] @ trial.camera.jacobian(pairs.camera_px),
            -trial.projector.jacobian(pairs.projector_px),
        ],
        axis=2,
    )
    scale = pairs.projector.unit_px / tolerance_px
    return (point - u[:, :2]) * scale, jacobian * scale


def _epipolar_residuals(pairs: _Pairs, tolerance_px: float, parameters: Floats) -> tuple[Floats, Floats]:
    """Distances (N, 1) from the epipolar lines of F (9) with lenses (8), and their Jacobian (N, 1, 17)."""
    trial, fundamental = pairs.with_lenses(parameters[9:]), parameters[:9].reshape(3, 3)
    x, u = trial.ideal()
    lines = x @ fundamental.T
    length = np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    distance = np.sum(lines * u, axis=1, keepdims=True) / length
    by_line = u / length
    by_line[:, :2] -= distance * lines[:, :2] / length**2
    by_camera = np.einsum("ni,nij->nj", (by_line @ fundamental)[:, :2], trial.camera.jacobian(pairs.camera_px))
    by_projector = np.einsum("ni,nij->nj", lines[:, :2] / length, trial.projector.jacobian(pairs.projector_px))
    by_fundamental = (by_line[:, :, None] * x[:, None, :]).reshape(-1, 9)
    jacobian = np.concatenate([by_fundamental, by_camera, by_projector], axis=1)
    scale = pairs.projector.unit_px / tolerance_px
    return distance * scale, jacobian[:, None, :] * scale


def _sampled_homography(pairs: _Pairs, rng: np.random.Generator) -> Floats:
    """The best of many homographies through four surfels each."""
    x, u = pairs.ideal()
    picks = rng.integers(0, len(x), (_SAMPLES, 4))
    xs, us, zero = x[picks], u[picks], np.zeros((_SAMPLES, 4, 3))
    rows = np.concatenate(
        [
            np.concatenate([xs, zero, -us[..., :1] * xs], axis=2),
            np.concatenate([zero, xs, -us[..., 1:2] * xs], axis=2),
        ],
        axis=1,
    )
    candidates = np.linalg.svd(rows)[2][:, 8].reshape(-1, 3, 3)
    predicted = x @ candidates.transpose(0, 2, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.linalg.norm(predicted[..., :2] / predicted[..., 2:] - u[:, :2], axis=2)
    return _least(candidates, distance)


def _eight_point_candidates(pairs: _Pairs, rng: np.random.Generator) -> Floats:
    """Fundamental matrices with uᵀ F x = 0 of eight surfels each (Hartley & Zisserman, section 11.2), (S, 3, 3)."""
    x, u = pairs.ideal()
    rows = (u[:, :, None] * x[:, None, :]).reshape(len(x), 9)
    candidates = np.linalg.svd(rows[rng.integers(0, len(x), (_SAMPLES, 8))])[2][:, 8].reshape(-1, 3, 3)
    left, values, right = np.linalg.svd(candidates)
    values[:, 2] = 0.0
    singular: Floats = left @ (values[:, :, None] * right)
    return singular


def _parallax_candidates(pairs: _Pairs, homography: Floats, off_plane: Ints, rng: np.random.Generator) -> Floats:
    """F = [e]× H with e where the parallaxes of two surfels off the plane intersect, (S, 3, 3)."""
    x, u = pairs.ideal()
    lines = np.cross((x[off_plane]) @ homography.T, u[off_plane])
    picks = rng.integers(0, len(lines), (_SAMPLES, 2))
    epipoles = np.cross(lines[picks[:, 0]], lines[picks[:, 1]])
    epipoles = epipoles[np.linalg.norm(epipoles, axis=1) > 0]
    candidates: Floats = np.cross(np.eye(3)[None], epipoles[:, None, :]).transpose(0, 2, 1) @ homography
    return candidates


def _best_candidate(pairs: _Pairs, candidates: Floats) -> Floats:
    x, u = pairs.ideal()
    lines = candidates @ x.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.abs(np.einsum("sin,ni->sn", lines, u)) / np.hypot(lines[:, 0], lines[:, 1])
    return _least(candidates, distance)


def _least(candidates: Floats, distance: Floats) -> Floats:
    """The candidate with the least sum of square roots of distances (S, N): robust without a scale."""
    score = np.sqrt(distance).sum(axis=1)
    best: Floats = candidates[np.argmin(np.where(np.isfinite(score), score, np.inf))]
    return best


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
