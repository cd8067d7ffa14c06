"""Polynomials are orthonormal and span the cubics; derivatives are those of known functions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.numerics import CUBIC, by_pixel, coefficients_of, monomials, normalisation, orthonormal_polynomials

PIXELS = np.stack(np.meshgrid(np.arange(300.0, 1500, 40), np.arange(100.0, 900, 40)), axis=-1).reshape(-1, 2)


def cubic(pixels: np.ndarray) -> np.ndarray:
    x, y = (pixels.T - 700) / 400
    return 1 - x + 0.5 * y + x * y - x**3 + 0.2 * x * y**2


@pytest.mark.parametrize("weighted", [False, True])
def test_polynomials_are_orthonormal_and_span_the_cubics(weighted: bool) -> None:
    root = np.random.default_rng(1).uniform(0.5, 2, len(PIXELS)) if weighted else None
    basis = orthonormal_polynomials(PIXELS, root)
    assert basis.shape == (len(PIXELS), CUBIC)
    np.testing.assert_allclose(basis.T @ basis, np.eye(CUBIC), atol=1e-12)
    values = cubic(PIXELS) * (1 if root is None else root)
    np.testing.assert_allclose(basis @ (basis.T @ values), values, atol=1e-9)
    quartic = (PIXELS[:, 0] - 900) ** 4 / 400.0**4
    left = quartic - basis @ (basis.T @ quartic)
    assert np.linalg.norm(left) > 0.01 * np.linalg.norm(quartic)


def test_the_first_polynomials_are_of_the_lowest_degree() -> None:
    basis = orthonormal_polynomials(PIXELS)
    assert np.ptp(basis[:, 0]) < 1e-12
    linear = np.column_stack([np.ones(len(PIXELS)), PIXELS])
    left = basis[:, :3] - linear @ np.linalg.lstsq(linear, basis[:, :3], rcond=None)[0]
    assert np.abs(left).max() < 1e-9


def test_coefficients_give_the_values_back() -> None:
    terms, weight = monomials(PIXELS).T, np.ones(len(PIXELS))
    values = np.column_stack([cubic(PIXELS), -cubic(PIXELS)])
    np.testing.assert_allclose(terms.T @ coefficients_of(terms, values, weight), values, atol=1e-8)
    terms[CUBIC:] = 0.0  # singular: the solution of minimum norm
    np.testing.assert_allclose(terms.T @ coefficients_of(terms, values, weight), values, atol=1e-8)


@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e4))
def test_normalised_points_have_mean_0_and_mean_length_root_2(centre: float, size: float) -> None:
    points = centre + size * np.random.default_rng(2).normal(size=(50, 2))
    scale = normalisation(points)
    moved = points @ scale[:2, :2].T + scale[:2, 2]
    np.testing.assert_allclose(moved.mean(axis=0), 0, atol=1e-6)
    assert np.linalg.norm(moved, axis=1).mean() == pytest.approx(np.sqrt(2), rel=1e-6)


def test_derivatives_by_pixels_are_those_of_a_quadratic() -> None:
    def values(pixels: np.ndarray) -> np.ndarray:
        x, y = pixels.T
        return np.stack([x**2 + 3 * y, x * y], axis=1)

    x, y = PIXELS.T
    expected = np.stack([np.stack([2 * x, np.full_like(x, 3)], axis=1), np.stack([y, x], axis=1)], axis=1)
    np.testing.assert_allclose(by_pixel(values, PIXELS), expected, rtol=1e-9)
