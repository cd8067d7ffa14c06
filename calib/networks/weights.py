"""What a network is fitted with once its noise is measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import UNKNOWN, Fit, Joint, NoiseLevels, measured, of_station
from calib.networks.initialisation import Grown
from calib.networks.network import Network
from calib.networks.observations import NetworkProblem, PlaneObservation
from calib.networks.shared_points import SharedPoints
from calib.networks.surfaces import PlaneRelief, likeliest_steepness, surfaces_of
from calib.numerics import Bools, Floats

_BENT = 4.0  # times the variance of noise
_START = 3.0  # sigmas of the scatter of matches


@dataclass(frozen=True, eq=False)
class Weights:
    """`variances` (M,) of each sight's cells; `joints` that tie devices where planes do not; `surfaces` of all planes,
    if any is not flat. `rough`: no noise is measured yet, so that nothing tells whether they are.
    """

    variances: Sequence[Floats]
    joints: Sequence[Joint[Network]] = ()
    surfaces: Sequence[PlaneRelief] = ()
    rough: bool = False

    @classmethod
    def of_noise(cls, sights: Sequence[PlaneObservation]) -> "Weights":
        """By the scatter of matches alone."""
        return cls([sight.cells.sigma_px**2 for sight in sights], rough=True)

    def measured_anew(
        self, grown: Grown, sights: Sequence[PlaneObservation], fit: Fit[Network], free: Bools
    ) -> tuple[NoiseLevels, "Weights"]:
        """By the residuals of a fit that these weights led to."""
        joints = grown.joints(fit.layout)
        if not self.surfaces:
            levels = measured(self.problem(grown, sights, free), fit, [1] * len(grown.labelled), one_rig=False)
            variances = levels.variances(sights)
            sights_and_variances = zip(sights, variances, strict=True)
            if self.rough or all(
                np.median(variance / s.cells.sigma_px**2) <= _BENT for s, variance in sights_and_variances
            ):
                return levels, Weights(variances, joints)
            variances = [(_START * sight.cells.sigma_px) ** 2 for sight in sights]
            return levels, Weights(variances, joints, surfaces_of(sights, fit, variances))
        return self._of_surfaces(grown, sights, fit, free, joints)

    def _of_surfaces(
        self,
        grown: Grown,
        sights: Sequence[PlaneObservation],
        fit: Fit[Network],
        free: Bools,
        joints: Sequence[SharedPoints],
    ) -> tuple[NoiseLevels, "Weights"]:
        """By what the heights of planes leave of the residuals; with the likeliest steepness of these."""
        solved = [surface.solved(fit.layout) for surface in self.surfaces]
        steepness, determined = likeliest_steepness(self.surfaces, solved, fit, free)
        remaining = [
            (sight, residual)
            for surface, heights in zip(self.surfaces, solved, strict=True)
            for sight, residual in zip(surface.sights, heights.left, strict=True)
        ]
        absorbed = (np.count_nonzero(free) + determined) / len(sights)
        stations = []
        for capture in range(len(grown.labelled)):
            own = [(sight.cells, residual) for sight, residual in remaining if sight.capture == capture]
            sighted, residuals = [cells for cells, _ in own], [residual for _, residual in own]
            stations.append(of_station(sighted, residuals, absorbed)[0] if own else UNKNOWN)
        levels = NoiseLevels(tuple(stations), np.ones(len(fit.layout.planes)), 1.0)
        surfaces = [
            replace(surface, steepness=steep, variances=tuple(levels.variances(surface.sights)))
            for surface, steep in zip(self.surfaces, steepness, strict=True)
        ]
        return levels, Weights(levels.variances(sights), joints, surfaces)

    def problem(self, grown: Grown, sights: Sequence[PlaneObservation], free: Bools) -> NetworkProblem:
        """What tells of a network, if all planes are flat."""
        return NetworkProblem(sights, self.variances, grown.knowledge.prior(grown.names), free, self.joints)

    def fitted(
        self, grown: Grown, sights: Sequence[PlaneObservation], network: Network, free: Bools, tolerance: float
    ) -> Fit[Network]:
        """The most likely network near one."""
        problem = self.problem(grown, sights, free)
        if not self.surfaces:
            return problem.minimise(network, tolerance=tolerance)
        uneven = replace(problem, parts=(), variances=(), joints=(*self.surfaces, *self.joints))
        fit = uneven.minimise(network, tolerance=tolerance)
        residuals = (sight.predict(fit.layout)[0] - sight.cells.projector_px for sight in sights)
        return replace(fit, residuals=tuple(residuals))
