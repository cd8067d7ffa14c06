"""The evidence for radial terms, against the Savage–Dickey ratio by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from calib.refinement.distortion_model_selection import choose_lens_order
from calib.refinement.likelihood import Fit, Prior
from tests.calib.refinement.conftest import Case

K1, K2, PROJECTOR_K1, PROJECTOR_K2 = 3, 4, 8, 9
TERMS = (K1, K2, PROJECTOR_K1, PROJECTOR_K2)


def fit_with(case: Case, values: dict[int, float]) -> Fit:
    devices = np.concatenate([case.truth.camera, case.truth.projector])
    for column, value in values.items():
        devices[column] = value
    state = replace(case.truth, camera=devices[:5], projector=devices[5:])
    return Fit(0.0, np.zeros(state.size), np.zeros((state.size, state.size)), state, ())


def prior_with(case: Case, known: tuple[int, ...]) -> Prior:
    prior = case.prior
    for column in known:
        prior = prior.with_known(column)
    return prior


def covariance(case: Case, sigma: dict[int, float]) -> np.ndarray:
    diagonal = np.full(case.truth.size, 1e-6)
    for column, value in sigma.items():
        diagonal[column] = value**2
    return np.diag(diagonal)


@pytest.mark.parametrize("k1", [0.0, 0.01, 0.03, -0.05])
def test_one_term_is_weighed_by_the_densities_of_zero(case: Case, k1: float) -> None:
    sigma, sigma_before = 0.01, 0.1
    prior = prior_with(case, (K2, PROJECTOR_K1, PROJECTOR_K2))
    assert prior.sigma[K1] == pytest.approx(sigma_before)
    found = choose_lens_order(fit_with(case, {K1: k1}), covariance(case, {K1: sigma}), prior)
    ratio = norm.pdf(0, k1, sigma) / norm.pdf(0, 0, sigma_before)  # without the term over with it
    is_left_out = ratio > 1
    assert found.terms == (0 if is_left_out else 1, 0)
    assert found.zero == ((K1,) if is_left_out else ())
    assert found.probability == pytest.approx(max(ratio, 1) / (1 + ratio), rel=1e-6)
    assert found.spread[K1, K1] == pytest.approx(k1**2 * min(ratio, 1) / (1 + ratio), rel=1e-6, abs=1e-15)


@pytest.mark.parametrize(
    ("values", "terms"),
    [
        ({}, (0, 0)),
        ({K1: -0.05}, (1, 0)),
        ({PROJECTOR_K1: 0.04}, (0, 1)),
        ({K1: -0.05, K2: 0.02}, (2, 0)),
        ({K1: -0.05, PROJECTOR_K1: 0.04, PROJECTOR_K2: -0.02}, (1, 2)),
        ({PROJECTOR_K2: 0.02}, (0, 2)),
    ],
)
def test_terms_that_stand_out_are_kept(case: Case, values: dict[int, float], terms: tuple[int, int]) -> None:
    sigma = dict.fromkeys(TERMS, 0.001)
    found = choose_lens_order(fit_with(case, values), covariance(case, sigma), case.prior)
    assert found.terms == terms
    assert 0.5 < found.probability < 1.0
    kept = {*TERMS} - {*found.zero}
    assert kept == {*TERMS[: terms[0]], *TERMS[2 : 2 + terms[1]]}


def test_leaving_a_term_out_moves_what_goes_with_it(case: Case) -> None:
    prior = prior_with(case, (K2, PROJECTOR_K1, PROJECTOR_K2))
    of = covariance(case, {K1: 0.01, 0: 0.02})
    of[0, K1] = of[K1, 0] = 0.9 * 0.01 * 0.02
    found = choose_lens_order(fit_with(case, {K1: 0.005}), of, prior)
    assert found.terms == (0, 0)
    kept = 1 - found.probability
    by_focal = -0.9 * 0.02 / 0.01 * 0.005  # the conditional mean of the other column
    assert found.spread[0, 0] == pytest.approx(kept * by_focal**2, rel=1e-6)
    assert found.spread[0, K1] == pytest.approx(kept * by_focal * -0.005, rel=1e-6)


def test_terms_that_are_known_are_none_to_choose(case: Case) -> None:
    found = choose_lens_order(fit_with(case, {}), covariance(case, {}), prior_with(case, TERMS))
    assert (found.terms, found.zero, found.probability) == ((0, 0), (), 1.0)
