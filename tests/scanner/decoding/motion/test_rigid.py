"""The motion of a device as the robust mean of its observations, compared with NumPy."""

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN
from scanner.decoding.motion import fit_motion
from scanner.decoding.motion.pixels import COLUMNS, PRIOR_PX


def test_the_motion_is_the_robust_mean_of_the_observations() -> None:
    rng = np.random.default_rng(7)
    design, group = rng.normal(0, 1, (300, COLUMNS)), np.repeat(np.arange(30), 10)
    truth, precision = rng.normal(0, 0.5, COLUMNS), rng.uniform(50, 500, 300)
    seen = design @ truth + rng.normal(0, 1, 300) / np.sqrt(precision)
    seen[::9] += 3.0
    weight, prior = precision, np.eye(COLUMNS) / PRIOR_PX**2
    for _ in range(6):
        normal = design.T @ (weight[:, None] * design) + prior
        motion = np.linalg.solve(normal, design.T @ (weight * seen))
        off = np.abs(seen - design @ motion) * np.sqrt(precision)
        scale = SIGMA_PER_MEDIAN * np.median(off)
        weight = precision * np.minimum(1, 2 * scale / off)
    found = fit_motion(design, seen, precision, group)
    np.testing.assert_allclose(found.motion, motion, atol=5e-3)
    scores = weight * (seen - design @ motion)
    sums = np.stack([np.bincount(group, column * scores) for column in design.T])
    inverse = np.linalg.inv(normal)
    sigmas = np.sqrt(np.diag(inverse @ sums @ sums.T @ inverse + scale**2 * inverse))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sigmas, rtol=0.1)
    assert 0.3 < np.max(np.abs(truth - found.motion) / np.sqrt(np.diag(found.covariance))) < 4.0
