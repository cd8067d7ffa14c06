"""What is known of any device and wall before a match is seen."""

from dataclasses import dataclass

import numpy as np

from calib.networks.network import Network
from calib.numerics import Floats
from calib.refinement import PER_DEVICE
from calib.rooms.priors import squareness

_SCALE_SIGMA = 1e-6  # of the first two devices' distance, which is the unit


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
        every, cost = np.arange(network.size), 0.0
        for i, device in enumerate(network.devices):
            columns = every[network.device_columns(i)][:PER_DEVICE]
            deviation = (np.array([np.log(device.lens[0]), *device.lens[1:]]) - self.mean[i]) / self.sigma[i]
            cost += float(deviation @ deviation)
            gradient[columns] += deviation / self.sigma[i]
            information[columns, columns] += self.sigma[i] ** -2.0
        for off, slope in (*squareness(network, self.square, self.square_sigma), _unit_of_length(network)):
            cost += off**2
            gradient += slope * off
            information += np.outer(slope, slope)
        return cost, gradient, information


def _unit_of_length(network: Network) -> tuple[float, Floats]:
    """How far the first two devices' distance is from 1, in sigmas, and its slope (size,)."""
    apart = network.devices[1].pose.translation - network.devices[0].pose.translation
    length, slope = float(np.linalg.norm(apart)), np.zeros(network.size)
    slope[network.device_columns(1)][-3:] = apart / length / _SCALE_SIGMA
    return (length - 1) / _SCALE_SIGMA, slope
