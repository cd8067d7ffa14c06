"""The likelihood of all sights for a network, with derivatives; and the prior: what is known of any device and wall.

Cells deviate in projector pixels under Huber's loss, as in `calib.refinement.likelihood`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry import tangent_basis
from calib.networks.network import Network
from calib.networks.sights import PER_SIGHT, Sight
from calib.numerics import NIELSEN, Bools, Floats, Quadratic, descend
from calib.refinement import PER_DEVICE, misfit

_STEPS = 60
_SCALE_SIGMA = 1e-6  # of the first two devices' distance, which is the unit
_BEHIND = 100.0


@dataclass(frozen=True, eq=False)
class NetworkPrior:
    """`mean`, `sigma` (devices, 8): of log f, x_0, y_0 and lens terms of each device. `square`: pairs of planes that
    are perpendicular but for `square_sigma` radians.
    """

    mean: Floats
    sigma: Floats
    square: tuple[tuple[int, int], ...]
    square_sigma: float

    def cost(self, network: Network) -> tuple[float, Floats, Floats]:
        """Of a network, with half its gradient (size,) and Gauss–Newton Hessian (size, size)."""
        gradient, information = np.zeros(network.size), np.zeros((network.size, network.size))
        cost = 0.0
        for i, device in enumerate(network.devices):
            columns = network.device_columns(i)[:PER_DEVICE]
            deviation = (np.array([np.log(device.lens[0]), *device.lens[1:]]) - self.mean[i]) / self.sigma[i]
            cost += float(deviation @ deviation)
            gradient[columns] += deviation / self.sigma[i]
            information[columns, columns] += self.sigma[i] ** -2.0
        rows: list[tuple[float, Floats]] = []
        for pair in self.square:
            normals = [network.planes[plane].normal for plane in pair]
            slope = np.zeros(network.size)
            for plane, own, other in zip(pair, normals, normals[::-1], strict=True):
                slope[network.plane_columns(plane)[:2]] += tangent_basis(own).T @ other / self.square_sigma
            rows.append((float(normals[0] @ normals[1]) / self.square_sigma, slope))
        rows.append(_unit_of_length(network))
        for off, slope in rows:
            cost += off**2
            gradient += slope * off
            information += np.outer(slope, slope)
        return cost, gradient, information


def _unit_of_length(network: Network) -> tuple[float, Floats]:
    """How far the first two devices' distance is from 1, in sigmas, and its slope (size,)."""
    apart = network.devices[1].pose.translation - network.devices[0].pose.translation
    length, slope = float(np.linalg.norm(apart)), np.zeros(network.size)
    slope[network.device_columns(1)[-3:]] = apart / length / _SCALE_SIGMA
    return (length - 1) / _SCALE_SIGMA, slope


@dataclass(frozen=True, eq=False)
class Fit(Quadratic):
    """A network with its cost, and each sight's `residuals` (M, 2) in projector px."""

    network: Network
    residuals: tuple[Floats, ...]


def evaluate(sights: Sequence[Sight], network: Network, prior: NetworkPrior, variances: Sequence[Floats]) -> Fit:
    """The cost of a network with its derivatives; `variances`: (M,) for each sight, of each coordinate of each cell."""
    cost, gradient, information = prior.cost(network)
    own_columns, residuals = np.arange(PER_SIGHT, dtype=np.int32), []
    for sight, variance in zip(sights, variances, strict=True):
        predicted, jacobian, depths = sight.predict(network)
        residual, seen = np.empty_like(predicted), np.ascontiguousarray(sight.cells.projector_px)
        slope, curvature = np.zeros(len(own_columns)), np.zeros((len(own_columns), len(own_columns)))
        own = misfit(predicted, seen, jacobian, depths, variance, own_columns, residual, slope, curvature)
        residuals.append(residual)
        if not np.isfinite(own):
            cost += _BEHIND * len(seen)
            continue
        columns = sight.columns(network)
        cost += own
        gradient[columns] += slope
        information[np.ix_(columns, columns)] += curvature
    return Fit(cost, gradient, information, network, tuple(residuals))


def minimise(
    sights: Sequence[Sight],
    network: Network,
    prior: NetworkPrior,
    variances: Sequence[Floats],
    free: Bools,
    tolerance: float,
) -> Fit:
    """The nearest minimum over the `free` columns (size,); ends when a step promises to gain less than `tolerance`."""
    return descend(
        evaluate(sights, network, prior, variances),
        lambda fit, step: evaluate(sights, fit.network.moved(step), prior, variances),
        lambda _, decrement: decrement < tolerance,
        NIELSEN,
        _STEPS,
        free=np.flatnonzero(free),
    )
