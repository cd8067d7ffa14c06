"""Heights of a plane, eliminated from the likelihood of a network."""

from dataclasses import replace

import numpy as np
import pytest

from calib.networks import NetworkEstimate, estimate_network
from calib.networks.weights import PlaneRelief
from calib.numerics import Floats
from calib.synthetic import RoomOptions, random_network

STEEPNESS, SIGMA_PX = 0.003, 0.5


@pytest.fixture(scope="module")
def estimate() -> NetworkEstimate:
    made = random_network(np.random.default_rng(3), 2, 1, RoomOptions(boxes=0, count=4_000))
    return estimate_network(made.captures, {name: device.size for name, device in made.devices.items()})


@pytest.fixture(scope="module")
def surface(estimate: NetworkEstimate) -> PlaneRelief:
    """The floor, with three waves along the image of each camera."""
    sights = tuple(sight for sight in estimate.sights if sight.plane == 0)
    assert len(sights) == 2
    variances = tuple(np.full(len(sight.cells), SIGMA_PX**2) for sight in sights)
    modes = tuple(np.cos(sight.cells.camera_px[:, :1] * [0.002, 0.004, 0.007]) for sight in sights)
    return PlaneRelief(sights, variances, modes, STEEPNESS)


def observed(estimate: NetworkEstimate, surface: PlaneRelief) -> tuple[Floats, Floats]:
    """Residuals (2 M,) of all sights, and their derivatives by the waves' amplitudes (2 M, 3)."""
    off, by_wave = [], []
    for sight, modes in zip(surface.sights, surface.modes, strict=True):
        predicted, jacobian, _ = sight.predict(estimate.network)
        off.append((predicted - sight.cells.projector_px).ravel())
        by_wave.append((jacobian[:, :, -1:] * modes[:, None]).reshape(-1, modes.shape[1]))
    return np.concatenate(off), np.concatenate(by_wave)


def test_the_cost_is_that_of_correlated_residuals(estimate: NetworkEstimate, surface: PlaneRelief) -> None:
    off, by_wave = observed(estimate, surface)
    covariance = SIGMA_PX**2 * np.eye(len(off)) + STEEPNESS**2 * by_wave @ by_wave.T
    expected = off @ np.linalg.solve(covariance, off)
    flat = np.sum(off**2) / SIGMA_PX**2
    cost = surface.misfit(estimate.network).cost
    assert 0 < expected < flat
    assert cost == pytest.approx(expected, rel=1e-6)


def test_the_gradient_is_that_of_the_cost(estimate: NetworkEstimate, surface: PlaneRelief) -> None:
    network, term = estimate.network, surface.misfit(estimate.network)
    scale = 1e-3 / np.sqrt(np.diag(term.information))
    rng = np.random.default_rng(0)
    for _ in range(10):
        step = np.zeros(network.size)
        step[term.columns] = scale * rng.normal(size=len(term.columns))
        after, before = (surface.misfit(network.moved(sign * step)).cost for sign in (1, -1))
        assert (after - before) / 4 == pytest.approx(term.gradient @ step[term.columns], rel=1e-3, abs=1e-9)


def test_heights_are_found(estimate: NetworkEstimate, surface: PlaneRelief) -> None:
    """Cells moved as by waves, without noise: the prior alone keeps amplitudes smaller."""
    amplitudes = np.array([0.002, -0.003, 0.001])
    sights = []
    for sight, modes in zip(surface.sights, surface.modes, strict=True):
        predicted, jacobian, _ = sight.predict(estimate.network)
        seen = predicted + jacobian[:, :, -1] * (modes @ amplitudes)[:, None]
        sights.append(replace(sight, cells=replace(sight.cells, projector_px=seen)))

    heights = replace(surface, sights=tuple(sights)).solved(estimate.network)

    shrunk = amplitudes - heights.alone @ amplitudes / STEEPNESS**2
    np.testing.assert_allclose(heights.amplitudes, shrunk, rtol=1e-6)
    assert 0.5 < heights.amplitudes[1] / amplitudes[1] < 1
    assert 2 < heights.told(STEEPNESS, np.zeros((estimate.network.size,) * 2)) < 3
