"""What is known of devices and walls before a match is seen."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation import Term, squareness
from calib.geometry import FACES, Size
from calib.networks.network import PLACE, WARP, Device, Network
from calib.numerics import Bools, Floats
from calib.refinement import PER_DEVICE, SQUARENESS_DEG, LensPrior, of_any_device
from calib.self_calibration import PrincipalPoint

_CENTRE_SIGMA = 0.03  # of a camera's principal point around its image's centre, in image widths
_EXACTLY_SQUARE = 1e-3  # degrees, for walls that are said to be exactly square
WARP_SIGMA = np.array([0.01, 0.01, 0.03, 0.03])  # of pictures that may have one: of a few per cent of keystone
_SCALE_SIGMA = 1e-6  # of the first two devices' distance, which is the unit


@dataclass(frozen=True, eq=False)
class NetworkPrior:
    """`mean`, `sigma` (devices, 8): of log f, x_0, y_0 and lens terms of each device; a sigma of 0 holds. `square`:
    pairs of planes that are perpendicular but for `square_sigma` radians.
    """

    mean: Floats
    sigma: Floats
    square: tuple[tuple[int, int], ...]
    square_sigma: float

    def terms(self, network: Network) -> Iterator[Term]:
        """The cost of a network: of devices and their pictures, of angles, and of the unit of length."""
        for i, device in enumerate(network.devices):
            columns = np.r_[network.device_columns(i)]
            root = np.where(self.sigma[i] > 0, 1 / np.where(self.sigma[i] > 0, self.sigma[i], 1.0), 0.0)
            deviations = (np.array([np.log(device.lens[0]), *device.lens[1:]]) - self.mean[i]) * root
            yield Term.gaussian(columns[:PER_DEVICE], deviations, np.diag(root))
            yield Term.gaussian(columns[WARP], device.warp / WARP_SIGMA, np.diag(1 / WARP_SIGMA))
        yield from squareness(network, self.square, self.square_sigma)
        yield _unit_of_length(network)


def _unit_of_length(network: Network) -> Term:
    """How far the first two devices' distance is from 1."""
    apart = network.devices[1].pose.translation - network.devices[0].pose.translation
    length, columns = float(np.linalg.norm(apart)), np.r_[network.device_columns(1)][PLACE]
    return Term.gaussian(columns, np.array([length - 1]) / _SCALE_SIGMA, apart[None] / length / _SCALE_SIGMA)


@dataclass(frozen=True)
class NetworkKnowledge:
    """`sizes` of all devices' images, by name; by how much the corner's walls are off square (standard deviation);
    `lenses` and principal `points` of devices of which more is known than of any.
    """

    sizes: Mapping[str, Size]
    cameras: frozenset[str]
    squareness_deg: float = SQUARENESS_DEG
    lenses: Mapping[str, LensPrior] = field(default_factory=dict)
    points: Mapping[str, PrincipalPoint] = field(default_factory=dict)

    def lens(self, name: str) -> LensPrior:
        """That of an ordinary lens, if none is known."""
        return self.lenses.get(name, LensPrior())

    def point(self, name: str) -> PrincipalPoint:
        """The image's centre, if none is known; with a sigma that is a camera's."""
        width, height = self.sizes[name]
        centre = PrincipalPoint(((width - 1) / 2, (height - 1) / 2), _CENTRE_SIGMA * width)
        return self.points.get(name, centre)

    def prior(self, names: tuple[str, ...]) -> NetworkPrior:
        """On these devices, and on planes of which the first three are the corner's."""
        mean, sigma = np.empty((len(names), PER_DEVICE)), np.empty((len(names), PER_DEVICE))
        for i, name in enumerate(names):
            mean[i], sigma[i] = of_any_device(self.sizes[name], self.lens(name))
            if name in self.cameras:
                mean[i, 1:3], sigma[i, 1:3] = self.point(name).px, self.point(name).sigma_px
        pairs = tuple((a, b) for a in FACES for b in FACES if a < b)
        return NetworkPrior(mean, sigma, pairs, float(np.radians(max(self.squareness_deg, _EXACTLY_SQUARE))))

    def free(self, network: Network, names: Sequence[str]) -> Bools:
        """Columns that are estimated, (size,): all but the first device's pose and what is exactly known."""
        free = np.ones(network.size, np.bool_)
        free[network.device_columns(0)][PER_DEVICE:] = False
        for i, sigma in enumerate(self.prior(tuple(names)).sigma):
            free[network.device_columns(i)][:PER_DEVICE] = sigma > 0
            free[network.device_columns(i)][WARP] = False
        return free

    def held(self, name: str, device: Device) -> Device:
        """A device with what is exactly known of it."""
        prior = self.prior((name,))
        return replace(device, lens=np.where(prior.sigma[0] > 0, device.lens, prior.mean[0]))
