"""A camera that was moved between its captures: fits in which it stands elsewhere in one of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.networks.growth import ROUGH, Grown
from calib.networks.network import Network
from calib.networks.sights import Sight
from calib.networks.weights import Weights
from calib.numerics import Floats, Ints
from calib.refinement import PER_DEVICE
from calib.rooms.likelihood import Fit

_SAME = np.array([1e-5, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])  # of log f, x_0, y_0, k1, k2, p1, p2, k3


@dataclass(frozen=True)
class SameLens:
    """Two devices, by number, that are one in two places."""

    one: int
    other: int

    def columns(self, network: Network) -> Ints:
        """Those of both lenses, (16,)."""
        every = np.arange(network.size, dtype=np.int32)
        return np.concatenate([every[network.device_columns(device)][:PER_DEVICE] for device in (self.one, self.other)])

    def misfit(self, network: Network) -> tuple[float, Floats, Floats]:
        """Of the difference of both lenses: cost, half its gradient (16,) and half its Hessian (16, 16)."""
        first, second = (network.devices[device].lens for device in (self.one, self.other))
        off = np.array([np.log(second[0] / first[0]), *(second - first)[1:]]) / _SAME
        slope = np.concatenate([-np.diag(1 / _SAME), np.diag(1 / _SAME)])
        return float(off @ off), slope @ off, slope @ slope.T


def likeliest_move(grown: Grown, sights: Sequence[Sight], fit: Fit[Network]) -> tuple[float, str]:
    """The cost, under the scatter of matches, if one camera was moved for one of its captures, and which; of the
    likeliest. Infinite if none has two.
    """
    candidates = [(np.inf, "")]
    for capture, (name, _) in enumerate(grown.labelled):
        number, elsewhere = grown.names.index(name), len(grown.names)
        own = {sight.capture for sight in sights if sight.camera == number}
        if capture not in own or len(own) == 1:
            continue
        split = [replace(sight, camera=elsewhere) if sight.capture == capture else sight for sight in sights]
        network = replace(fit.layout, devices=(*fit.layout.devices, fit.layout.devices[number]))
        more = replace(grown, names=(*grown.names, name))
        weights = replace(Weights.of_noise(split), joints=(SameLens(number, elsewhere),))
        candidates.append((weights.fitted(more, split, network, more.free(network), ROUGH).cost, name))
    return min(candidates)
