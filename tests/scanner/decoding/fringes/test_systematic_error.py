"""Systematic errors of fringes, from the disagreement of their periods."""

import numpy as np
from numpy.typing import NDArray

from scanner.decoding.fringes.systematic_error import correct_systematic

Floats = NDArray[np.float32]


def test_the_disagreement_of_two_periods_is_measured() -> None:
    rng = np.random.default_rng(0)
    shape = (96, 96)
    noise = [np.full(shape, sigma**2, np.float32) for sigma in (0.03, 0.02)]
    coordinates = [rng.normal(0, np.sqrt(variance)).astype(np.float32) for variance in noise]
    coordinates[0][:, 48:] += 0.2
    long, short = added((8.43, 6.1), coordinates, noise)
    assert np.median(long[:, :40]) < 0.03**2 / 4
    assert 0.15**2 < np.median(long[:, 56:]) < 0.3**2
    assert np.all(short[:, 56:] < long[:, 56:])


def test_longer_fringes_are_aligned_with_the_shortest() -> None:
    """Interreflection shifts them with the cube of their periods; they still reduce the noise."""
    rng = np.random.default_rng(0)
    periods, shape = (16.0, 9.0, 6.7), (96, 97)
    true = np.linspace(0.0, 0.02, shape[1]) * np.ones(shape)
    sigmas = (0.03, 0.02, 0.02)
    seen = [
        (true * period**3 / 6.7**3 + rng.normal(0, sigma, shape)).astype(np.float32).ravel()
        for period, sigma in zip(periods, sigmas, strict=True)
    ]
    coordinates, usable = np.stack(seen), rng.uniform(size=true.size) > 0.1
    variances = np.stack([np.full(true.size, sigma**2, np.float32) for sigma in sigmas])
    weights = 1 / variances
    correct_systematic(periods, coordinates, variances, usable, shape)
    mean = np.sum(weights * coordinates, axis=0) / weights.sum(axis=0)
    error, of_shortest = ((value - true.ravel()).reshape(shape) for value in (mean, seen[2]))
    assert np.abs(np.mean(error - of_shortest, axis=0)[4:-4]).max() < 0.01
    assert abs(np.mean(error)) < 2 * 0.02 / np.sqrt(true.size) + 2e-4
    assert 0.5 < np.std(error) / np.std(of_shortest) < 0.85


def added(periods: tuple[float, ...], coordinates: list[Floats], noise: list[Floats]) -> Floats:
    """Return what is added to the noise variances (fringes, H, W) where all pixels are usable."""
    count, shape = len(periods), noise[0].shape
    variances = np.stack(noise)
    flat = variances.reshape(count, -1)
    correct_systematic(periods, np.stack(coordinates).reshape(count, -1), flat, np.ones(flat.shape[1], np.bool_), shape)
    return variances - np.stack(noise)


def test_the_middle_of_three_periods_gets_the_larger_of_two_errors() -> None:
    shape = (40, 41)
    offsets = [np.full(shape, offset, np.float32) for offset in (0.0, 0.1, 0.4)]
    long, middle, short = added((21.0, 20.0, 19.0), offsets, [np.zeros(shape, np.float32)] * 3)
    cubes = np.array([21.0, 20.0, 19.0]) ** 3
    assert np.allclose(long, 1.6 * 0.1**2 * cubes[0] / (cubes[0] + cubes[1]), rtol=1e-4)
    assert np.allclose(middle, 1.6 * 0.3**2 * cubes[1] / (cubes[1] + cubes[2]), rtol=1e-4)
    assert np.allclose(short, 1.6 * 0.3**2 * cubes[2] / (cubes[1] + cubes[2]), rtol=1e-4)
