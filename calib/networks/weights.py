"""What a network is fitted with once its noise is measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.networks.growth import Grown
from calib.networks.network import Network
from calib.networks.shared_points import SharedPoints
from calib.networks.sights import Sight
from calib.numerics import Bools, Floats
from calib.rooms.likelihood import Fit, minimise
from calib.rooms.noise import Levels, measured

_BENT = 4.0  # times the variance of noise: pixels that devices share then tell more than the plane that they are on


@dataclass(frozen=True, eq=False)
class Weights:
    """`variances` (M,) of each sight's cells, and `joints` that tie devices where planes do not, or are not flat."""

    variances: Sequence[Floats]
    joints: Sequence[SharedPoints] = ()

    @classmethod
    def of_noise(cls, sights: Sequence[Sight]) -> "Weights":
        """By the scatter of matches alone."""
        return cls([sight.cells.sigma_px**2 for sight in sights])

    def measured_anew(
        self, grown: Grown, sights: Sequence[Sight], fit: Fit[Network], free: Bools
    ) -> tuple[Levels, "Weights"]:
        """By the residuals of a fit that these weights led to."""
        levels = measured(sights, fit, self.variances, free, [1] * len(grown.labelled), one_rig=False)
        variances = levels.variances(sights)
        each = zip(sights, variances, strict=True)
        bent = [(s.capture, int(s.cells.plane[0])) for s, v in each if np.median(v / s.cells.sigma_px**2) > _BENT]
        return levels, Weights(variances, grown.joints(fit.layout, bent))

    def fitted(
        self, grown: Grown, sights: Sequence[Sight], network: Network, free: Bools, tolerance: float
    ) -> Fit[Network]:
        """The most likely network near one."""
        prior = grown.knowledge.prior(grown.names)
        return minimise(sights, network, prior, self.variances, free, joints=self.joints, tolerance=tolerance)
