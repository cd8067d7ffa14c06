"""A parameter more: its evidence and covariance are those of an exact integration."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from calib.refinement import alternative

PROBABILITY, SPREAD, SIGMA = 0.01, 0.02, 0.1


@given(st.integers(0, 2**32 - 1), st.floats(-0.06, 0.06))
def test_odds_and_moments_of_a_linear_model_are_exact(seed: int, slope: float) -> None:
    """y = a + b t + noise, with b = 0 or b normal with sigma `SPREAD`."""
    rng = np.random.default_rng(seed)
    design = np.stack([np.ones(40), rng.uniform(0, 2, 40)], axis=1)
    seen = design @ [1.0, slope] + SIGMA * rng.normal(size=40)

    def least(b: float) -> float:
        """χ² at the likeliest a."""
        rest = seen - b * design[:, 1]
        return float(np.sum((rest - rest.mean()) ** 2) / SIGMA**2)

    off = (design[:, 0] * seen.mean() - seen) / SIGMA**2
    information = design.T @ design / SIGMA**2 + np.diag([0.0, SPREAD**-2])
    found = alternative(information, design.T @ off, np.array([True, False]), 1, PROBABILITY, SPREAD)

    def density(b: float) -> float:
        return float(np.exp((least(0.0) - least(b)) / 2 - (b / SPREAD) ** 2 / 2) / (np.sqrt(2 * np.pi) * SPREAD))

    evidence, mean, square = (quad(lambda b, n=n: b**n * density(b), -0.3, 0.3, limit=200)[0] for n in range(3))
    np.testing.assert_allclose(found.odds, PROBABILITY * evidence, rtol=1e-6)
    np.testing.assert_allclose(found.value, mean / evidence, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.value**2 + found.sigma**2, square / evidence, rtol=1e-6)
    # A slope of b moves the mean by −b times the mean of t.
    of_mean = found.added(0.5)[0, 0]
    np.testing.assert_allclose(of_mean, 0.5 * square / evidence * design[:, 1].mean() ** 2, rtol=1e-6)
