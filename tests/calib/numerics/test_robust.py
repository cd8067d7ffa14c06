"""Order statistics against NumPy's, weights against their definitions, fits against truth among outliers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calib.numerics import (
    Floats,
    biweight,
    biweight_slope,
    blocks,
    clustered_scatter,
    fit_huber,
    fit_reweighted,
    huber_loss,
    huber_weights,
    median,
    medians,
    quantile,
    robust_sigmas,
    shrunk_scatter,
)

VALUES = arrays.arrays(np.float64, st.integers(1, 40), elements=st.floats(-1e6, 1e6))
SIZES = arrays.arrays(np.float64, 20, elements=st.floats(1e-6, 1e6))


@given(values=VALUES, share=st.floats(0, 1))
def test_quantile_equals_numpys(values: Floats, share: float) -> None:
    assert quantile(values, share) == pytest.approx(np.quantile(values, share), rel=1e-9, abs=1e-6)


@given(values=VALUES)
def test_median_equals_numpys(values: Floats) -> None:
    assert median(values) == pytest.approx(np.median(values), rel=1e-12, abs=1e-9)


@given(
    arrays.arrays(np.float32, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.floats(-99, 99, width=32))
)
def test_medians_along_an_axis_equal_numpys(values: np.ndarray) -> None:
    for axis in (0, 1):
        np.testing.assert_allclose(medians(values, axis), np.median(values, axis=axis), rtol=1e-6, atol=1e-4)


def test_sigmas_ignore_a_fifth_of_outliers() -> None:
    values = np.random.default_rng(1).normal(5, [[1.0], [3.0]], (2, 5000)).astype(np.float32)
    values[:, :1000] += 500
    relative = robust_sigmas(values) / (1.0, 3.0)
    assert 1.2 < relative.min() < relative.max() < 1.6  # an outlier counts, but not its size


@given(SIZES, st.floats(1e-3, 1e3))
def test_hubers_loss_has_hubers_weights_as_its_slope(size: Floats, limit: float) -> None:
    """The derivative of ρ by r is 2 w r, and ρ is quadratic inside, linear outside the limit."""
    step = 1e-6 * size
    slope = (huber_loss(size + step, limit) - huber_loss(size - step, limit)) / (2 * step)
    inside = size < limit * (1 - 1e-5)
    np.testing.assert_allclose(slope, 2 * huber_weights(size, limit) * size, rtol=1e-4)
    np.testing.assert_allclose(huber_loss(size, limit)[inside], size[inside] ** 2, rtol=1e-12)
    assert (huber_loss(size, limit) <= size**2 * (1 + 1e-12)).all()


def test_no_residual_has_the_whole_weight() -> None:
    assert huber_weights(np.zeros(2), 3.0).tolist() == [1.0, 1.0]
    assert huber_loss(np.zeros(2), 3.0).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("seed", range(5))
def test_a_line_is_found_among_outliers(seed: int) -> None:
    """An ordinary fit would be off by more than 5; a tenth of the points is 100 away."""
    rng = np.random.default_rng(seed)
    terms = np.stack([np.ones(400), rng.uniform(-1, 1, 400)])
    observed = np.array([2.0, -3.0]) @ terms + rng.normal(0, 0.1, 400)
    observed[rng.choice(400, 40, replace=False)] += 100
    plain = fit_reweighted(terms, observed, np.ones_like, np.ones(400), 1)
    fit = fit_huber(terms, observed, 2.0, 10)
    assert abs(plain - (2.0, -3.0)).max() > 5
    assert abs(fit.parameters - (2.0, -3.0)).max() < 0.06
    assert 0.09 < fit.scale < 0.14
    sigma = np.sqrt(np.diag(fit.covariance(np.arange(400))))
    assert 0.005 < sigma.min() < sigma.max() < 0.04
    assert fit.gained > 0


def test_several_values_are_fitted_at_once() -> None:
    terms = np.stack([np.ones(50), np.linspace(0, 1, 50)])
    truth = np.array([[1.0, 2.0, 3.0], [-1.0, 0.0, 1.0]])
    np.testing.assert_allclose(fit_reweighted(terms, truth.T @ terms, np.ones_like, np.ones(1), 1), truth, atol=1e-12)


def test_points_of_a_cluster_count_as_one() -> None:
    scores = np.random.default_rng(3).normal(size=(30, 2))
    alone = clustered_scatter(scores, np.arange(30))
    np.testing.assert_allclose(alone, scores.T @ scores)
    repeated = clustered_scatter(np.repeat(scores, 4, axis=0), np.repeat(np.arange(30), 4))
    np.testing.assert_allclose(repeated, 16 * alone)


@pytest.mark.parametrize("common", [0.0, 0.2])
def test_few_clusters_give_directions_their_true_sigma(common: float) -> None:
    rng, errors = np.random.default_rng(4), []
    cluster = np.repeat(np.arange(30), 40)
    for _ in range(100):
        middle = rng.standard_normal((30, 6))[cluster]
        jacobian = middle + 0.5 * rng.standard_normal((len(cluster), 6))
        observed = common * rng.standard_normal(30)[cluster] + rng.standard_normal(len(cluster))
        estimate = fit_reweighted(jacobian.T, observed, biweight, np.ones(len(cluster)), 15)
        residual = observed - jacobian @ estimate
        bread = np.linalg.inv((biweight_slope(residual)[:, None] * jacobian).T @ jacobian)
        covariance = bread @ shrunk_scatter(jacobian, residual, cluster) @ bread
        errors.append(np.linalg.solve(np.linalg.cholesky(covariance), estimate))
    assert 0.85 < np.sqrt(np.mean(np.square(errors))) < 1.15
    assert np.isinf(shrunk_scatter(jacobian, residual, cluster % 2)).all()


@given(
    pixel=st.lists(st.tuples(st.integers(0, 200), st.integers(0, 200)), min_size=1, max_size=60),
    side_px=st.integers(1, 50),
)
def test_pixels_share_a_label_if_they_share_a_block(pixel: list[tuple[int, int]], side_px: int) -> None:
    labels = blocks(np.array(pixel), side_px)
    squares = [(x // side_px, y // side_px) for x, y in pixel]
    assert set(labels) == set(range(len(set(squares))))
    assert len(set(zip(labels.tolist(), squares, strict=True))) == len(set(squares))
