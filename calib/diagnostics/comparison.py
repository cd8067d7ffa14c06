"""Compares two calibrations of one rig over image and depth, with the sigma of their difference.

Points along the rays of the first are projected to matches, which the second triangulates. The best rigid motion is
removed from differences and sigmas, and the best scale if a length is not known.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from calib.diagnostics.error_propagation import SystematicErrors
from calib.geometry import Calibration, Matches, cross, intersect
from calib.numerics import Bools, Floats

_SIGNIFICANT = 0.999
_FEWEST = 8
_ROUNDING = 1e-9
_HARDLY_COUNTS = 0.02  # relative to the sigmas, root mean square
_SAME_RAY = 1e-6  # in focal lengths


@dataclass(frozen=True)
class Difference:
    """The difference of two calibrations at points that both devices of the first one see, in its unit."""

    camera_px: Floats
    """Camera pixels, (N, 2)."""
    depth: Floats
    """Depths, (N,)."""
    length: Floats
    """Distance between the points, (N,)."""
    length_sigma: Floats
    """Standard deviation of `length` by the covariances, 0 where none is known, (N,)."""
    px: Floats
    """Distance between their predicted projector pixels, (N,)."""
    px_sigma: Floats
    """Standard deviation of `px`, the same, (N,)."""
    chi2: float
    """The squared difference in sigmas over all points."""
    freedom: int
    """Degrees of freedom of `chi2`."""
    unexplained: float
    """Root mean square of the part of `length` that no modelled error explains."""
    scale: float
    """Factor on the second calibration's lengths; 1 if both are metric."""

    @property
    def limit(self) -> float:
        """The 99.9 % quantile of `chi2`."""
        return float(scipy.special.chdtri(self.freedom, 1 - _SIGNIFICANT)) if self.freedom else 0.0

    @property
    def agree(self) -> bool:
        """Whether the sigmas explain the difference."""
        allowed = float(np.sqrt(np.mean(self.length_sigma**2)))
        return self.chi2 <= self.limit and self.unexplained <= allowed

    @property
    def sigmas(self) -> Floats:
        """Lengths over their sigmas, (N,); huge where none is known."""
        return self.length / np.maximum(self.length_sigma, 1e-300)


def compare(
    first: SystematicErrors, second: SystematicErrors, camera_px: Floats, depths: Floats, *, metric: bool
) -> Difference | None:
    """Compare at camera pixels (N, 2), each at all depths (D,). None if the two see too little in common.

    `metric`: both have the same unit of length. Otherwise the best scale is estimated. Raises ValueError if an
    uncertainty reaches devices that cannot see what both do.
    """
    pixels = np.tile(camera_px, (len(depths), 1))
    depth = np.repeat(depths, len(camera_px))
    points, matches, by_first = _seen(first.calibration, pixels, depth)
    met = intersect(matches, second.calibration)
    visible = np.flatnonzero(by_first & met.in_front)
    if len(visible) < _FEWEST:
        return None
    pixels, depth, points, matches = pixels[visible], depth[visible], points[visible], matches[visible]
    weight = 1 / np.linalg.norm(points, axis=1)
    turn, scale = _similarity(met.points[visible], points, weight, metric=metric)
    difference = scale * (_centred(met.points[visible], weight) @ turn.T) - _centred(points, weight)

    def triangulated(calibration: Calibration) -> Floats:
        return intersect(matches, calibration).points

    effects = np.concatenate(
        [first.of_function(triangulated), scale * np.einsum("ij,njs->nis", turn, second.of_function(triangulated))],
        axis=2,
    )
    if not np.isfinite(effects).all():
        raise ValueError("a covariance reaches lenses that have no ray for some pixels")
    weighted = weight[:, None, None] * effects
    motions = weight[:, None, None] * _motions(points, metric=metric)
    flat, basis = weighted.reshape(3 * len(points), -1), np.linalg.qr(motions.reshape(3 * len(points), -1))[0]
    flat = flat - basis @ (basis.T @ flat)
    off = (weight[:, None] * difference).ravel()
    off = off - basis @ (basis.T @ off)
    squared, freedom, rest = _in_sigmas(off, flat)
    per_point = flat.reshape(len(points), 3, -1) / weight[:, None, None]
    scaled = second.calibration.scaled(scale)
    grown = SystematicErrors(scaled, second.uncertainty, second.log_scale)
    expected = _transfer(first.calibration, pixels, depth)
    shifts = np.concatenate(
        [uncertainty.of_function(lambda rig: _transfer(rig, pixels, depth)) for uncertainty in (first, grown)], axis=2
    )
    return Difference(
        pixels,
        depth,
        np.linalg.norm(off.reshape(-1, 3), axis=1) / weight,
        np.sqrt(np.sum(per_point**2, axis=(1, 2))),
        np.linalg.norm(_transfer(scaled, pixels, depth) - expected, axis=1),
        np.sqrt(np.sum(shifts**2, axis=(1, 2))),
        squared,
        freedom,
        float(np.sqrt(np.mean(np.sum((rest.reshape(-1, 3) / weight[:, None]) ** 2, axis=1)))),
        scale,
    )


def _transfer(rig: Calibration, pixels: Floats, depth: Floats) -> Floats:
    """Projector pixels (N, 2) of points at given depths along camera pixels."""
    points = depth[:, None] * rig.camera.unproject(pixels)
    return rig.projector.project(rig.pose @ points)


def _seen(rig: Calibration, pixels: Floats, depth: Floats) -> tuple[Floats, Matches, Bools]:
    """Points (N, 3), their matches, and which of them the projector sees as well, (N,)."""
    points = depth[:, None] * rig.camera.unproject(pixels)
    there = rig.pose @ points
    projected = rig.projector.project(there)
    with np.errstate(invalid="ignore", divide="ignore"):
        # A distortion model that folds back maps far points into the picture again; these are not valid.
        off = np.linalg.norm(rig.projector.unproject(projected)[:, :2] - there[:, :2] / there[:, 2:], axis=1)
        inside = np.all((projected >= 0) & (projected <= np.array(rig.projector.size) - 1), axis=1)
    somewhere = np.where(inside[:, None], projected, 0.0)  # an extreme lens gives no finite pixel
    return points, Matches(pixels, somewhere), inside & (off < _SAME_RAY) & np.isfinite(points).all(axis=1)


def _centred(points: Floats, weight: Floats) -> Floats:
    return points - np.average(points, axis=0, weights=weight**2)


def _similarity(points: Floats, onto: Floats, weight: Floats, *, metric: bool) -> tuple[Floats, float]:
    """The rotation (3, 3) and the scale that bring points (N, 3) nearest to others: Umeyama 1991, IEEE PAMI 13, 376."""
    here, there = weight[:, None] * _centred(points, weight), weight[:, None] * _centred(onto, weight)
    left_vectors, singular, right = np.linalg.svd(there.T @ here)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left_vectors @ right))])
    scale = 1.0 if metric else float(singular @ signs) / float(np.sum(here**2))
    return (left_vectors * signs) @ right, scale


def _motions(points: Floats, *, metric: bool) -> Floats:
    """Derivatives of points (N, 3) by a rotation, a shift and, unless metric, a scale: (N, 3, 6 or 7)."""
    turns = cross(np.eye(3)[None], points[:, None]).transpose(0, 2, 1)
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    return np.concatenate([turns, shifts, *([] if metric else [points[:, :, None]])], axis=2)


def _in_sigmas(off: Floats, effects: Floats) -> tuple[float, int, Floats]:
    """χ² of differences (M,), given the `effects` (M, S) of error sources of one sigma; its degrees of freedom; and the
    part of the differences that no source explains.

    Effects are linear. Second-order effects count as noise. So does a small share of the total, because a
    covariance is unreliable in its weakest directions.
    """
    left_vectors, size, _ = np.linalg.svd(effects, full_matrices=False)
    allowed = float(np.linalg.norm(size))
    noise = allowed**2 / np.sqrt(len(off)) + _HARDLY_COUNTS * allowed + _ROUNDING
    significant = size > noise
    along = left_vectors[:, significant].T @ off
    every = left_vectors[:, size > _ROUNDING]
    rest: Floats = off - every @ (every.T @ off)
    return float(np.sum(along**2 / (size[significant] ** 2 + noise**2))), int(significant.sum()), rest
