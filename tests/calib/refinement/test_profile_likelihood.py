"""The posterior along the focal length: Gaussian where it should be, and with its true spread otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from calib.numerics import covariance_of, inverse_of
from calib.refinement.focal_sweep import at_focal
from calib.refinement.likelihood import CornerFit
from calib.refinement.parameters import CAMERA, PROJECTOR
from calib.refinement.profile_likelihood import Valley, centred, log_volume_across, trace_valley
from calib.refinement.profile_minimiser import relax
from tests.calib.refinement.conftest import Case

_Z = np.linspace(-5, 5, 1001)


@given(st.integers(0, 10_000))
def test_columns_of_very_different_scales_are_inverted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root, scale = rng.normal(size=(6, 8)), 10.0 ** rng.uniform(-6, 6, 6)
    plain = root @ root.T + 0.1 * np.eye(6)
    found = inverse_of(plain * np.outer(scale, scale))
    np.testing.assert_allclose(found * np.outer(scale, scale), np.linalg.inv(plain), rtol=1e-6, atol=1e-8)


def test_known_parameters_have_no_covariance() -> None:
    information = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
    free = np.array([True, False, True])
    found = covariance_of(information, free)
    np.testing.assert_allclose(found[np.ix_(free, free)], np.linalg.inv(information[np.ix_(free, free)]), rtol=1e-12)
    assert not found[1].any()
    assert not found[:, 1].any()


def test_a_well_determined_focal_has_the_covariance_of_the_curvature(case: Case) -> None:
    valley = trace_valley(case.problem, case.best)
    by_curvature = covariance_of(case.best.information, case.prior.free)
    sigma = np.sqrt(by_curvature[CAMERA.start, CAMERA.start])
    assert np.all(np.diff(valley.focal_px) > 0)
    assert valley.cost.min() == 0.0
    assert np.all(valley.cost[[0, -1]] > 9)
    in_sigmas = np.log(valley.focal_px / case.best.state.camera[0]) / sigma
    np.testing.assert_allclose(valley.cost, in_sigmas**2, rtol=0.2, atol=0.02)  # lens terms bend it a little
    found = valley.covariance(case.best, case.prior.free)
    for column in (CAMERA.start, PROJECTOR.start, PROJECTOR.start + 1):
        assert found[column, column] == pytest.approx(by_curvature[column, column], rel=0.1)


@pytest.mark.parametrize(("share", "sigmas"), [(0.0, 1.0), (0.02, 1.19), (0.05, 6.8)])
def test_a_second_basin_widens_the_sigma_from_one_in_forty_on(case: Case, share: float, sigmas: float) -> None:
    """Two basins; the smaller has the given `share`. The central 68 % are in the larger, but not always 95 %."""
    sigma, apart = 0.02, 0.5
    t = np.linspace(-5 * sigma, apart + 5 * sigma, 200)
    density = (1 - share) * np.exp(-((t / sigma) ** 2) / 2) + share * np.exp(-(((t - apart) / sigma) ** 2) / 2)
    states = tuple(at_focal(case.truth, case.truth.camera[0] * float(np.exp(step))) for step in t)
    cost = -2 * np.log(np.maximum(density, 1e-12))
    valley = Valley(np.array([state.camera[0] for state in states]), cost - cost.min(), states, np.zeros(len(states)))
    none = CornerFit(0.0, np.zeros(case.truth.size), np.eye(case.truth.size), case.truth, ())
    found = valley.covariance(none, np.arange(case.truth.size) == CAMERA.start)
    low, high = np.interp([0.1587 / (1 - share), 0.8413 / (1 - share)], ndtr(_Z), _Z) * sigma
    assert np.log(np.array(valley.interval_px) / case.truth.camera[0]) == pytest.approx([low, high], rel=0.02)
    assert np.sqrt(found[CAMERA.start, CAMERA.start]) == pytest.approx(sigmas * sigma, rel=0.04)


def test_a_curved_profile_adds_its_moments(case: Case) -> None:
    """A Gaussian along log f, along which the projector's centre moves with the square: E[t²] = σ², E[t⁴] = 3 σ⁴."""
    sigma, bend = 0.03, 900.0
    t = np.linspace(-5 * sigma, 5 * sigma, 81)
    steps = np.zeros((len(t), case.truth.size))
    steps[:, CAMERA.start], steps[:, PROJECTOR.start + 1] = t, bend * t**2
    states = tuple(case.truth.moved(step) for step in steps)
    valley = Valley(np.array([state.camera[0] for state in states]), (t / sigma) ** 2, states, np.zeros(len(states)))
    none = CornerFit(0.0, np.zeros(case.truth.size), np.eye(case.truth.size), case.truth, ())
    only_focal = np.arange(case.truth.size) == CAMERA.start
    found = valley.covariance(none, only_focal)
    assert found[CAMERA.start, CAMERA.start] == pytest.approx(sigma**2, rel=1e-3)
    centre = PROJECTOR.start + 1
    assert found[centre, centre] == pytest.approx(3 * bend**2 * sigma**4, rel=0.01)
    assert abs(found[CAMERA.start, centre]) < 1e-6
    across = valley.covariance(none, only_focal | (np.arange(case.truth.size) == centre))
    assert across[centre, centre] - found[centre, centre] == pytest.approx(1.0, rel=1e-6)


def test_a_widening_profile_shifts_the_mean_to_its_wide_side(case: Case) -> None:
    """A Gaussian times exp(slope t) is a Gaussian of the same width, shifted by slope σ²."""
    sigma, slope = 0.03, 20.0
    t = np.linspace(-5 * sigma, 5 * sigma, 31)
    states = tuple(at_focal(case.truth, case.truth.camera[0] * float(np.exp(step))) for step in t)
    valley = Valley(np.array([state.camera[0] for state in states]), (t / sigma) ** 2, states, slope * t)
    shift = slope * sigma**2
    expected = np.array([shift - sigma, shift, shift + sigma])
    found = np.log(np.array([valley.interval_px[0], valley.median_px, valley.interval_px[1]]) / case.truth.camera[0])
    np.testing.assert_allclose(found, expected, atol=0.02 * sigma)
    assert valley.posterior_cost.min() == 0.0
    assert abs(t[np.argmin(valley.posterior_cost)] - shift) < t[1] - t[0]


@pytest.mark.parametrize(("column", "power"), [(0, 2), (1, 4), (2, 0), (4, 6)])
def test_the_volume_across_the_profile_includes_a_prior_that_grows_with_the_focal(
    case: Case, column: int, power: int
) -> None:
    """One lens term of the projector is free, which the matches tell: against the integral over it, by a sum."""
    column += PROJECTOR.start + 3
    ratio, told = 1.3, 1e-3  # of the focal lengths; the matches' standard deviation of the term, in the prior's
    only = np.isin(np.arange(case.truth.size), [CAMERA.start, column])
    prior = replace(case.prior, sigma=np.where(only, case.prior.sigma, 0.0))
    step = np.zeros(case.truth.size)
    step[PROJECTOR.start], step[column] = np.log(ratio), 0.5 * prior.sigma[column]
    state = case.truth.moved(step)
    grown = prior.for_focals_of(state, case.truth)
    width = ratio**power
    assert grown.sigma[column] == pytest.approx(width * prior.sigma[column])
    own = np.where(only, grown.root_precision, 0.0) ** 2
    information = np.diag(own + only / (told * np.where(only, prior.sigma, 1.0)) ** 2)
    found = log_volume_across(CornerFit(0.0, np.zeros(state.size), information, state, ()), case.truth, prior)

    log_density = -(_Z**2) / 2 - (told * _Z / width) ** 2 / 2 - np.log(width)
    integral = np.sum(np.exp(log_density)) * (_Z[1] - _Z[0]) * told * prior.sigma[column]
    assert found == pytest.approx(np.log(integral / np.sqrt(2 * np.pi)), abs=0.01)


def test_walking_the_profile_reports_a_lower_minimum(case: Case) -> None:
    sigma = np.sqrt(covariance_of(case.best.information, case.prior.free)[CAMERA.start, CAMERA.start])
    beside = at_focal(case.best.state, case.best.state.camera[0] * float(np.exp(1.5 * sigma)))
    begun = relax(case.problem.holding(CAMERA.start), beside, tolerance=1e-6)
    valley = trace_valley(case.problem, begun)
    assert 1.0 < valley.gain <= begun.cost - case.best.cost + 1e-6
    assert abs(np.log(valley.lowest.camera[0] / case.best.state.camera[0])) < 0.7 * sigma
    middle = centred(case.problem, begun, valley)
    assert abs(np.log(middle.state.camera[0] / case.best.state.camera[0])) < 0.2 * sigma
