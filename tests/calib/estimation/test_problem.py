"""Problems of maximum likelihood: terms, their sums, and what minimises them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from calib.estimation import Problem, Term, add_up
from calib.estimation.match_cells import Cells
from calib.numerics import Floats

TRUE = np.array([0.7, -1.3, 2.0])
SIGMA_PX = 0.2


@dataclass(frozen=True, eq=False)
class Curve:
    """Where a + b sin(c x) is drawn: a layout of three columns."""

    values: Floats

    @property
    def size(self) -> int:
        return len(self.values)

    def moved(self, step: Floats) -> "Curve":
        return Curve(self.values + step)


@dataclass(frozen=True, eq=False)
class Samples:
    """Cells whose x are the camera's and whose y follow the curve; behind a device where `depth` is negative."""

    cells: Cells
    depth: float = 1.0

    def predict(self, curve: Curve) -> tuple[Floats, Floats, Floats]:
        x, (a, b, c) = self.cells.camera_px[:, 0], curve.values
        pixels = np.stack([x, a + b * np.sin(c * x)], axis=1)
        jacobian = np.zeros((len(x), 2, 3))
        jacobian[:, 1] = np.stack([np.ones_like(x), np.sin(c * x), b * x * np.cos(c * x)], axis=1)
        return pixels, jacobian, np.full((len(x), 2), self.depth)

    def columns(self, curve: Curve) -> np.ndarray:
        return np.arange(curve.size)

    def carried(self, _: Curve) -> None:
        """Its own columns are the curve's."""


@dataclass(frozen=True, eq=False)
class Known:
    """The first column, with a standard deviation."""

    sigma: float

    def terms(self, curve: Curve) -> Iterator[Term]:
        yield Term.gaussian(np.array([0]), (curve.values[:1] - TRUE[:1]) / self.sigma, np.eye(1) / self.sigma)


def sampled(rng: np.random.Generator, count: int = 60, outliers: int = 0) -> Cells:
    x = np.linspace(0, 3, count)
    y = TRUE[0] + TRUE[1] * np.sin(TRUE[2] * x) + SIGMA_PX * rng.normal(size=count)
    y[:outliers] += 30.0
    ones, pixels = np.ones(count), np.stack([x, y], axis=1)
    return Cells(pixels, pixels, np.zeros(count, np.int32), ones, ones, 1.0, 0.0)


def problem_of(cells: Cells, sigma: float = 10.0, depth: float = 1.0) -> Problem[Curve, Samples]:
    variances = [np.full(len(cells), SIGMA_PX**2)]
    return Problem([Samples(cells, depth)], variances, Known(sigma), np.ones(3, np.bool_))


def test_estimates_scatter_as_their_covariance_says() -> None:
    errors, expected = [], np.zeros((3, 3))
    for seed in range(200):
        problem = problem_of(sampled(np.random.default_rng(seed)))
        fit = problem.minimise(Curve(TRUE + 0.05))
        errors.append(fit.state.values - TRUE)
        expected += problem.covariance(fit) / 200
    ratio = np.std(errors, axis=0) / np.sqrt(np.diag(expected))
    assert ratio.min() > 0.85
    assert ratio.max() < 1.15


def test_the_gradient_is_half_that_of_the_cost() -> None:
    problem = problem_of(sampled(np.random.default_rng(0), outliers=3))
    curve = Curve(TRUE + np.array([0.3, -0.2, 0.05]))
    for k, slope in enumerate(problem.evaluate(curve).gradient):
        ahead, behind = (problem.evaluate(curve.moved(sign * 1e-6 * np.eye(3)[k])).cost for sign in (1, -1))
        assert (ahead - behind) / 4e-6 == pytest.approx(slope, rel=1e-5)


def test_outliers_pull_no_more_than_three_sigmas_do() -> None:
    cells = sampled(np.random.default_rng(1))
    fit, pulled = (
        problem_of(some).minimise(Curve(TRUE)) for some in (cells, sampled(np.random.default_rng(1), outliers=1))
    )
    moved = np.abs(pulled.state.values - fit.state.values)
    assert 1e-4 < moved.max() < 0.1


def test_columns_that_are_held_stay_and_have_no_variance() -> None:
    free = np.array([True, False, True])
    start = problem_of(sampled(np.random.default_rng(2)))
    problem = Problem(start.parts, start.variances, start.prior, free)
    fit = problem.minimise(Curve(TRUE + 0.05))
    covariance = problem.covariance(fit)
    assert fit.state.values[1] == TRUE[1] + 0.05
    assert not covariance[1].any()
    assert not covariance[:, 1].any()
    assert covariance[0, 0] > 0


def test_cells_behind_a_device_cost_a_constant_or_make_a_layout_impossible() -> None:
    cells = sampled(np.random.default_rng(3))
    problem = problem_of(cells, depth=-1.0)
    fit = problem.evaluate(Curve(TRUE))
    assert fit.cost == pytest.approx(100.0 * len(cells))
    assert not fit.gradient.any()
    impossible = Problem(problem.parts, problem.variances, problem.prior, problem.free, behind=np.inf)
    assert impossible.evaluate(Curve(TRUE)).cost == np.inf


def test_terms_are_added_by_their_columns() -> None:
    rng = np.random.default_rng(4)
    slopes = [rng.normal(size=(5, 2)), rng.normal(size=(7, 3))]
    columns = [np.array([3, 0]), np.array([1, 3, 2])]
    deviations = [rng.normal(size=len(rows)) for rows in slopes]
    terms = map(Term.gaussian, columns, deviations, slopes)
    whole = np.zeros((12, 4))
    whole[:5, columns[0]], whole[5:, columns[1]] = slopes
    total, every = add_up(4, terms), np.concatenate(deviations)
    assert total.cost == pytest.approx(every @ every)
    np.testing.assert_allclose(total.gradient, whole.T @ every)
    np.testing.assert_allclose(total.information, whole.T @ whole)


def test_a_robust_term_is_gaussian_within_its_limit() -> None:
    rng = np.random.default_rng(5)
    residuals, jacobian = 0.3 * rng.normal(size=(20, 2)), rng.normal(size=(20, 2, 3))
    robust = Term.robust(np.arange(3), residuals, jacobian)
    gaussian = Term.gaussian(np.arange(3), residuals.ravel(), jacobian.reshape(-1, 3))
    assert robust.cost == pytest.approx(gaussian.cost)
    np.testing.assert_allclose(robust.information, gaussian.information)
    assert Term.robust(np.arange(3), residuals, jacobian, 0.1).cost < 0.9 * gaussian.cost
