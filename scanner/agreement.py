"""Do the two rays of a match meet? Which misses are disagreements, and which are the calibration's.

A miss has two causes. What the calibration leaves unexplained (mostly its lens model) varies smoothly over both
images; what the decoder got wrong does not. Only the second is a reason to drop a point, so the smooth part is
estimated from the matches themselves and taken off before judging.
"""

from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats
from calib.calibration import Calibration
from calib.fit_statistics import robust_sigma

_TREND_TERMS = 19
_TREND_SAMPLE = 5_000
_TREND_ITERATIONS = 10
# Of normally distributed misses one in 500 million lies beyond six standard deviations.
_OUTLIER_SIGMAS = 6.0
# A wrong bit or fringe order moves a match by whole projector pixels; below one pixel it is noise, never a mistake.
_FINEST_MISTAKE_PX = 1.0


@dataclass(frozen=True)
class Misses:
    """What misses are to be expected: a smooth trend over both images, the calibration's, and noise, the decoder's.

    `trend` (_TREND_TERMS,): coefficients of the cubics; `noise_px`: standard deviation of what remains; `limit_px`:
    beyond it the rays of a match disagree. In projector pixels.
    """

    trend: Floats
    noise_px: float
    limit_px: float

    def trend_px(self, camera_px: Floats, foot_px: Floats, calibration: Calibration) -> Floats:
        """The smooth part of the misses (N,) of points at pixels (N, 2) of both devices."""
        trend: Floats = self.trend @ _cubic_terms(camera_px, foot_px, calibration)
        return trend

    def agree(self, residual_px: Floats, trend_px: Floats) -> Bools:
        """Which of the misses (N,) are no mistakes."""
        # Where few matches hold the trend it may stray; rays that meet without its help are never dropped.
        agree: Bools = np.minimum(np.abs(residual_px - trend_px), np.abs(residual_px)) <= self.limit_px
        return agree


def expected_misses(camera_px: Floats, foot_px: Floats, residual_px: Floats, calibration: Calibration) -> Misses:
    """Tell the decoder's noise from the calibration's smooth error.

    `camera_px`, `foot_px` (N, 2) and `residual_px` (N,) of points in front of both devices, a sample from all over the
    image. The scale is the median absolute deviation from the trend, so the limit follows the capture and needs no
    setting.
    """
    trend = _smooth_trend(camera_px, foot_px, residual_px, calibration)
    if not len(residual_px):
        return Misses(trend, 0.0, _FINEST_MISTAKE_PX)
    noise = robust_sigma(residual_px - trend @ _cubic_terms(camera_px, foot_px, calibration))
    return Misses(trend, noise, max(_OUTLIER_SIGMAS * noise, _FINEST_MISTAKE_PX))


def _smooth_trend(camera_px: Floats, foot_px: Floats, residual_px: Floats, calibration: Calibration) -> Floats:
    """A cubic in the camera's plus a cubic in the projector's coordinates, fitted robustly (Huber's weights)."""
    solution: Floats = np.zeros(_TREND_TERMS)
    count = len(residual_px)
    if not count:
        return solution
    solution[0] = np.median(residual_px)
    if count < 20 * _TREND_TERMS:
        return solution
    sample = np.random.default_rng(0).permutation(count)[:_TREND_SAMPLE]
    basis, observed = _cubic_terms(camera_px[sample], foot_px[sample], calibration), residual_px[sample]
    solution[0] = np.median(observed)
    for _ in range(_TREND_ITERATIONS):
        error = np.abs(observed - solution @ basis)
        huber = 1.5 * robust_sigma(error) + 1e-12
        weighted = basis * (huber / np.maximum(huber, error))
        # On a single plane the two images are one homography apart and the terms nearly dependent: least norm then.
        solution = np.asarray(np.linalg.lstsq(weighted @ basis.T, weighted @ observed, rcond=1e-10)[0])
    return solution


def _cubic_terms(camera_px: Floats, foot_px: Floats, calibration: Calibration) -> Floats:
    """1, then x^i y^j up to degree 3 of both devices' pixels (N, 2), scaled to −1 … 1: (_TREND_TERMS, N)."""
    terms = np.empty((_TREND_TERMS, len(camera_px)))
    terms[0] = 1.0
    for first, pixels, device in ((1, camera_px, calibration.camera), (10, foot_px, calibration.projector)):
        x, y, xx, xy, yy, *cubes = terms[first : first + 9]
        np.subtract(pixels[:, 0] * (2 / device.width), 1.0, out=x)
        np.subtract(pixels[:, 1] * (2 / device.height), 1.0, out=y)
        factors = ((x, x), (x, y), (y, y), (xx, x), (xx, y), (x, yy), (yy, y))
        for (one, other), product in zip(factors, (xx, xy, yy, *cubes), strict=True):
            np.multiply(one, other, out=product)
    return terms
