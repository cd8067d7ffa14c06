"""Errors of triangulated points: covariances from the decoder's noise, and how far the rays of a match miss each other.

Rays miss for two reasons. Errors of the calibration, mostly of its lens model, vary smoothly over both images; errors
of the decoder do not. Only the latter are a reason to drop a point, so the smooth part is estimated from the matches
and subtracted first.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats, by_columns, compiled, fit_reweighted, huber_weights, robust_sigma

_TREND_TERMS = 19
_TREND_SAMPLE = 5_000
_TREND_ITERATIONS = 10
# Of normally distributed misses one in 500 million lies beyond six standard deviations.
_OUTLIER_SIGMAS = 6.0
# A wrong bit or fringe order moves a match by whole projector pixels; smaller deviations are noise.
_FINEST_MISTAKE_PX = 1.0


@dataclass(frozen=True)
class RayGapModel:
    """The model of ray misses: a smooth trend over both images (calibration) and noise (decoder), in projector pixels.

    `trend` (_TREND_TERMS,): coefficients of the cubics; `noise_px`: standard deviation of the rest; `limit_px`: largest
    miss of an agreeing match.
    """

    trend: Floats
    noise_px: float
    limit_px: float

    def trend_px(self, camera_px: Floats, foot_px: Floats, calibration: Calibration) -> Floats:
        """The smooth part of the misses (N,) of points at pixels (N, 2) of both devices."""
        return _trend(self.trend, camera_px, foot_px, calibration)


def expected_misses(camera_px: Floats, foot_px: Floats, residual_px: Floats, calibration: Calibration) -> RayGapModel:
    """Separate the decoder's noise from the calibration's smooth error.

    `camera_px`, `foot_px` (N, 2) and `residual_px` (N,) of points in front of both devices, a sample from all over the
    image. The scale is the median absolute deviation from the trend, so the limit follows the capture and needs no
    setting.
    """
    trend = _smooth_trend(camera_px, foot_px, residual_px, calibration)
    if not len(residual_px):
        return RayGapModel(trend, 0.0, _FINEST_MISTAKE_PX)
    noise = robust_sigma(residual_px - _trend(trend, camera_px, foot_px, calibration))
    return RayGapModel(trend, noise, max(_OUTLIER_SIGMAS * noise, _FINEST_MISTAKE_PX))


def _smooth_trend(camera_px: Floats, foot_px: Floats, residual_px: Floats, calibration: Calibration) -> Floats:
    """A cubic in the camera's plus a cubic in the projector's coordinates, fitted robustly (Huber's weights)."""
    count = len(residual_px)
    if count < 20 * _TREND_TERMS:
        return np.append(np.median(residual_px) if count else 0.0, np.zeros(_TREND_TERMS - 1))
    sample = np.random.default_rng(0).permutation(count)[:_TREND_SAMPLE]
    camera_px, foot_px, observed = camera_px[sample], foot_px[sample], residual_px[sample]
    one_term_each = np.eye(_TREND_TERMS)
    basis = np.stack([_trend(term, camera_px, foot_px, calibration) for term in one_term_each])
    # On a single plane a homography relates both images, and terms are nearly dependent: use the minimum norm.
    return fit_reweighted(basis, observed, _huber, _huber(observed - np.median(observed)), _TREND_ITERATIONS)


def _huber(error: Floats) -> Floats:
    """Huber's weights (N,), 1 up to one and a half robust sigmas."""
    return huber_weights(np.abs(error), 1.5 * robust_sigma(error) + 1e-12)


def _trend(coefficients: Floats, camera_px: Floats, foot_px: Floats, calibration: Calibration) -> Floats:
    """A constant and two cubics (_TREND_TERMS,) at pixels (N, 2) of both devices, scaled to −1 … 1: (N,)."""
    camera, projector = calibration.camera, calibration.projector
    scale = (2 / camera.width, 2 / camera.height, 2 / projector.width, 2 / projector.height)
    trend = np.empty(len(camera_px))
    _cubics(by_columns(camera_px).T, by_columns(foot_px).T, scale, tuple(coefficients.tolist()), trend)
    return trend


@compiled
def _cubics(
    camera_px: Floats, foot_px: Floats, scale: tuple[float, ...], coefficients: tuple[float, ...], trend: Floats
) -> None:
    """Evaluate a constant, and x^i y^j up to degree 3 at pixels (2, N) of the camera and of the projector."""
    constant, ax, ay, axx, axy, ayy, axxx, axxy, axyy, ayyy, bx, by, bxx, bxy, byy, bxxx, bxxy, bxyy, byyy = (
        coefficients
    )
    camera_x, camera_y, foot_x, foot_y = camera_px[0], camera_px[1], foot_px[0], foot_px[1]
    for i in range(len(trend)):
        x, y = camera_x[i] * scale[0] - 1.0, camera_y[i] * scale[1] - 1.0
        camera = x * (ax + x * (axx + x * axxx + y * axxy) + y * (axy + y * axyy)) + y * (ay + y * (ayy + y * ayyy))
        x, y = foot_x[i] * scale[2] - 1.0, foot_y[i] * scale[3] - 1.0
        projector = x * (bx + x * (bxx + x * bxxx + y * bxxy) + y * (bxy + y * bxyy)) + y * (by + y * (byy + y * byyy))
        trend[i] = constant + camera + projector


def point_covariances(matches: Matches, calibration: Calibration) -> Floats:
    """Covariance (N, 3, 3) of each triangulated point from `sigma_px` of its match, in the calibration's unit squared.

    Errors of the calibration, which neighbouring points share, are not included. Raises ValueError if the matches have
    no sigma.
    """
    if matches.sigma_px is None:
        raise ValueError("these matches have no sigma_px")
    by_sigma = matches.sigma_px[:, None, None] * by_projector_px(matches, calibration, matches.sigma_px)
    covariance: Floats = np.einsum("nia,nja->nij", by_sigma, by_sigma)
    return covariance


def by_projector_px(matches: Matches, calibration: Calibration, step_px: Floats) -> Floats:
    """Derivatives (N, 3, 2) of triangulated points by projector pixels: central differences over `step_px` (N,)."""
    derivative = np.empty((len(matches), 3, 2))
    for axis in (0, 1):
        step = step_px[:, None] * np.eye(2)[axis]
        ahead = intersect(replace(matches, projector_px=matches.projector_px + step), calibration).points
        behind = intersect(replace(matches, projector_px=matches.projector_px - step), calibration).points
        derivative[:, :, axis] = (ahead - behind) / (2 * step_px[:, None])
    return derivative
