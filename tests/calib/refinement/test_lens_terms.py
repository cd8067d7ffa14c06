"""Which lens terms are kept: those that the evidence is for."""

import numpy as np
import pytest

from calib.refinement import FURTHER_TERMS, LENS_CHOICES, SHARED, most_probable

SIGMA = np.zeros(SHARED)
SIGMA[list(FURTHER_TERMS)] = 1e-3


def covariance_with(sigma: float) -> np.ndarray:
    """All terms known that well, and each of them moves the first column as much as itself."""
    root = np.zeros((SHARED, SHARED))
    root[list(FURTHER_TERMS), list(FURTHER_TERMS)] = sigma
    root[0, list(FURTHER_TERMS)] = sigma
    return root @ root.T


@pytest.mark.parametrize("kept", [(), FURTHER_TERMS[:2], FURTHER_TERMS[2:3], FURTHER_TERMS])
def test_terms_that_the_estimate_is_sure_of_are_kept_and_no_others(kept: tuple[int, ...]) -> None:
    values = np.random.default_rng(1).normal(0, 1e-5, SHARED)
    values[list(kept)] += 5e-4
    found = most_probable(values, covariance_with(1e-5), SIGMA, LENS_CHOICES)
    assert {*FURTHER_TERMS} - {*found.zero} == {*kept}
    assert 0.9 < found.probability <= 1.0
    assert 0.0 <= found.spread[0, 0] < 1e-10  # a hundred times the terms' variance, were another choice as likely


def test_what_is_as_likely_as_not_widens_the_covariance() -> None:
    """Two terms where the density of the posterior at zero is that of the prior: either choice, half and half."""
    pair = list(FURTHER_TERMS[:2])
    sigma = np.zeros(SHARED)
    sigma[pair] = 1e-3
    size = 1e-4
    values = np.zeros(SHARED)
    values[pair] = size * np.sqrt(2 * np.log(1e-3 / size))  # each exp(−x² / 2 s²) / s = 1 / σ
    found = most_probable(values, covariance_with(size), sigma, [pair, ()])
    assert found.probability == pytest.approx(0.5, abs=1e-6)
    assert found.spread[0, 0] == pytest.approx(0.5 * values[pair].sum() ** 2, rel=1e-6)
