"""Noise parameters are recovered from residuals with known distributions."""

import numpy as np
import pytest

from calib.estimation.match_cells import Cells
from calib.estimation.noise import Noise, noise_of

SIGMA_PX = 0.05


def cells(coarseness: float | None = None) -> Cells:
    """A grid of 26 × 26 cells on each of three planes."""
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(0, 1000, 26), np.linspace(0, 800, 26))
    camera_px = np.tile(np.stack([u.ravel(), v.ravel()], axis=1), (3, 1))
    count = len(camera_px)
    rough = np.ones(count) if coarseness is None else np.exp(rng.normal(0, coarseness, count))
    return Cells(camera_px, camera_px, np.repeat(np.arange(3), count // 3), SIGMA_PX * rough, rough, 0.3, 0.0)


def drawn(of: Cells, tau_px: float, seed: int = 1) -> np.ndarray:
    """Residuals (M, 2) with variances σ² + τ², with τ proportional to the coarseness."""
    sigma = np.sqrt(of.sigma_px**2 + (tau_px * of.coarseness) ** 2)
    return np.random.default_rng(seed).normal(size=(len(of), 2)) * sigma[:, None]


@pytest.mark.parametrize("coarseness", [None, 0.5])
@pytest.mark.parametrize("tau_px", [0.03, 0.1, 0.4])
def test_excess_noise_is_measured(tau_px: float, coarseness: float | None) -> None:
    of = cells(coarseness)
    noise = noise_of(of, drawn(of, tau_px), absorbed=10)
    assert noise.systematic_px == pytest.approx(tau_px, rel=0.12)
    assert noise.inflation == 1.0
    assert noise.match_px == 0.3
    np.testing.assert_allclose(noise.variances(of), of.sigma_px**2 + (noise.systematic_px * of.coarseness) ** 2)


def test_residuals_as_small_as_stated_give_no_excess_noise() -> None:
    of = cells()
    noise = noise_of(of, 0.9 * drawn(of, 0.0), absorbed=10)
    assert noise.systematic_px == 0.0
    assert noise.inflation == 1.0
    # Of white noise the twenty polynomials of three planes hold their share: σ² · 60 / 2028 in each coordinate.
    assert noise.smooth_px == pytest.approx(0.9 * SIGMA_PX * np.sqrt(2 * 30 / len(of)), rel=0.25)


def test_outliers_are_not_taken_for_noise() -> None:
    of = cells()
    residual = drawn(of, 0.1)
    residual[::20] += 5.0
    assert noise_of(of, residual, absorbed=10).systematic_px == pytest.approx(0.1, rel=0.2)


def test_long_waves_inflate_the_variance() -> None:
    of = cells()
    x, y = (of.camera_px / (500, 400) - 1).T
    wave = 0.04 * np.stack([x**3 - x * y, 0.5 * y**2 - x**2 * y], axis=1)
    wave -= wave.mean(axis=0)
    residual = drawn(of, 0.0) + wave
    noise = noise_of(of, residual, absorbed=10)
    assert noise.smooth_px == pytest.approx(np.sqrt(np.mean(np.sum(wave**2, axis=1))), rel=0.2)
    variance = SIGMA_PX**2 + noise.systematic_px**2
    freedom = 3 * 2 * 10 - 10
    expected = (np.sum(wave**2) + 60 * SIGMA_PX**2) / variance / freedom
    assert noise.inflation == pytest.approx(expected, rel=0.15)
    np.testing.assert_allclose(noise.variances(of), noise.inflation * variance)


def test_few_cells_give_no_inflation() -> None:
    of = cells()[::60]
    noise = noise_of(of, drawn(of, 0.0) + 1.0, absorbed=0)
    assert (noise.smooth_px, noise.inflation) == (0.0, 1.0)


def test_variances_are_those_of_independent_cells_times_the_inflation() -> None:
    of = cells()
    np.testing.assert_allclose(Noise(0.3, 0.2, 0.0, 2.5).variances(of), 2.5 * (SIGMA_PX**2 + 0.04))
