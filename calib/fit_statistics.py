"""What fits of surfaces to points have in common: weights that outliers lose, and an honest covariance."""

import numpy as np

from calib.arrays import Floats, Ints

# The median absolute deviation of normal deviates is their standard deviation over this.
SIGMA_PER_MEDIAN = 1.4826
# Tukey's constant for 95 % efficiency with normal errors.
_TUKEY = 4.685


def robust_sigma(residual: Floats) -> float:
    """Standard deviation of residuals (N,) around zero, outliers left aside; 0 for none."""
    return SIGMA_PER_MEDIAN * float(np.median(np.abs(residual))) if len(residual) else 0.0


def biweight(residual: Floats) -> Floats:
    """Tukey's weights (N,), 1 for a residual of zero and 0 beyond 4.7 robust sigmas."""
    scale = _TUKEY * robust_sigma(residual)
    if scale == 0.0:
        exact: Floats = (residual == 0.0).astype(np.float64)
        return exact
    weights: Floats = np.clip(1 - (residual / scale) ** 2, 0, None) ** 2
    return weights


def clustered_covariance(jacobian: Floats, residual: Floats, weight: Floats, cluster: Ints) -> Floats:
    """Covariance (P, P) of a least-squares fit whose errors are alike within a cluster.

    `jacobian` (N, P), `residual`, `weight` and `cluster` (N,), cluster labels from 0. The sandwich estimator of Liang
    and Zeger (1986): points that err alike, as neighbouring pixels do, count as what they are worth together. It
    needs some ten clusters; with two or fewer it is infinite.
    """
    scores = (weight * residual)[:, None] * jacobian
    count = int(cluster.max()) + 1
    totals = np.stack([np.bincount(cluster, column, count) for column in scores.T], axis=1)
    occupied = int(np.count_nonzero(np.bincount(cluster, weight > 0, count)))
    normal = (weight[:, None] * jacobian).T @ jacobian
    if occupied <= 2 or np.linalg.matrix_rank(normal) < len(normal):
        return np.full_like(normal, np.inf)
    bread = np.linalg.inv(normal)
    covariance: Floats = occupied / (occupied - 1) * bread @ (totals.T @ totals) @ bread
    return covariance


def blocks(pixel: Ints, side_px: int) -> Ints:
    """The square of so many pixels that each pixel (N, 2) is in, as labels (N,) from 0 without gaps."""
    column, row = np.moveaxis(pixel // side_px, -1, 0)
    labels: Ints = np.unique(row * (int(column.max()) + 1) + column, return_inverse=True)[1].astype(np.int64)
    return labels
