"""Do the two rays of a match meet? Which misses are disagreements, and which are the calibration's.

A miss has two causes. What the calibration leaves unexplained (mostly its lens model) varies smoothly over both
images; what the decoder got wrong does not. Only the second is a reason to drop a point, so the smooth part is
estimated from the matches themselves and taken off before judging.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats
from calib.calibration import Calibration
from calib.triangulation import pieces

_TREND_TERMS = 19
_TREND_SAMPLE = 5_000
_TREND_ITERATIONS = 10
# Of normally distributed misses one in 500 million lies beyond six standard deviations.
_OUTLIER_SIGMAS = 6.0
# A wrong bit or fringe order moves a match by whole projector pixels; below one pixel it is noise, never a mistake.
_FINEST_MISTAKE_PX = 1.0
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class Agreement:
    """Which rays agree.

    `agrees` (N,); `trend_px` (N,): the smooth part of the residuals, the calibration's; `noise_px`: standard deviation
    of what remains, the decoder's; `limit_px`: beyond it the rays of a match disagree. All in projector pixels.
    """

    agrees: Bools
    trend_px: Floats
    noise_px: float
    limit_px: float


def judge(camera_px: Floats, foot_px: Floats, residual_px: Floats, calibration: Calibration) -> Agreement:
    """Tell the decoder's mistakes from its noise and from the calibration's smooth error.

    `camera_px`, `foot_px` (N, 2) and `residual_px` (N,) of points in front of both devices. The scale is the median
    absolute deviation from the trend, so the limit follows the capture and needs no setting.
    """
    if not len(residual_px):
        return Agreement(np.zeros(0, dtype=np.bool_), np.zeros(0), 0.0, _FINEST_MISTAKE_PX)
    trend = _smooth_trend(camera_px, foot_px, residual_px, calibration)
    rest = np.abs(residual_px - trend)
    noise = float(_MAD_TO_SIGMA * np.median(rest))
    limit = max(_OUTLIER_SIGMAS * noise, _FINEST_MISTAKE_PX)
    # Where few matches hold the trend it may stray; rays that meet without its help are never dropped.
    return Agreement(np.minimum(rest, np.abs(residual_px)) <= limit, trend, noise, limit)


def _smooth_trend(camera_px: Floats, foot_px: Floats, residual_px: Floats, calibration: Calibration) -> Floats:
    """A cubic in the camera's plus a cubic in the projector's coordinates, fitted robustly (Huber's weights)."""
    count = len(residual_px)
    if count < 20 * _TREND_TERMS:
        return np.full(count, np.median(residual_px))
    sample = np.random.default_rng(0).permutation(count)[:_TREND_SAMPLE]
    basis, observed = _cubic_terms(camera_px[sample], foot_px[sample], calibration), residual_px[sample]
    solution: Floats = np.zeros(_TREND_TERMS)
    solution[0] = np.median(observed)
    for _ in range(_TREND_ITERATIONS):
        error = np.abs(observed - solution @ basis)
        huber = 1.5 * _MAD_TO_SIGMA * float(np.median(error)) + 1e-12
        weighted = basis * (huber / np.maximum(huber, error))
        # On a single plane the two images are one homography apart and the terms nearly dependent: least norm then.
        solution = np.asarray(np.linalg.lstsq(weighted @ basis.T, weighted @ observed, rcond=1e-10)[0])
    trend = np.empty(count)

    def fill(at: slice) -> None:
        np.dot(solution, _cubic_terms(camera_px[at], foot_px[at], calibration), out=trend[at])

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for _ in pool.map(fill, pieces(count)):
            pass
    return trend


def _cubic_terms(camera_px: Floats, foot_px: Floats, calibration: Calibration) -> Floats:
    """1, then x^i y^j up to degree 3 of both devices' pixels (N, 2), scaled to −1 … 1: (_TREND_TERMS, N)."""
    terms = [np.ones(len(camera_px))]
    for pixels, device in ((camera_px, calibration.camera), (foot_px, calibration.projector)):
        x, y = 2 * pixels[:, 0] / device.width - 1, 2 * pixels[:, 1] / device.height - 1
        terms += [x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]
    return np.stack(terms)
