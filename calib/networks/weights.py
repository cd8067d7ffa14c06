"""What a network is fitted with once its noise is measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import UNKNOWN, Fit, NoiseLevels, measured, of_station
from calib.networks.initialisation import Grown
from calib.networks.network import Network
from calib.networks.observations import NetworkProblem
from calib.networks.surfaces import PlaneRelief, likeliest_steepness, surfaces_of
from calib.numerics import Bools

_BENT = 4.0  # times the variance of noise
_START = 3.0  # sigmas of the scatter of matches


@dataclass(frozen=True, eq=False)
class Weights:
    """A problem with the noise that its fits showed."""

    problem: NetworkProblem
    """What tells of a network, if all planes are flat."""
    surfaces: Sequence[PlaneRelief] = ()
    """All planes, if any is not flat."""
    rough: bool = False
    """No noise is measured yet, so that nothing tells whether they are."""

    def freeing(self, free: Bools) -> "Weights":
        """The same for other columns (size,) that are estimated."""
        return replace(self, problem=replace(self.problem, free=free))

    def measured_anew(self, grown: Grown, fit: Fit[Network]) -> tuple[NoiseLevels, "Weights"]:
        """By the residuals of a fit that these weights led to."""
        sights, problem = self.problem.parts, replace(self.problem, joints=grown.joints(fit.state))
        if self.surfaces:
            return self._of_surfaces(len(grown.labelled), fit, problem)
        levels = measured(problem, fit, [1] * len(grown.labelled), one_rig=False)
        variances = levels.variances(sights)
        is_flat = all(
            np.median(variance / sight.cells.sigma_px**2) <= _BENT
            for sight, variance in zip(sights, variances, strict=True)
        )
        if self.rough or is_flat:
            return levels, Weights(replace(problem, variances=variances))
        problem = replace(problem, variances=[(_START * sight.cells.sigma_px) ** 2 for sight in sights])
        return levels, Weights(problem, surfaces_of(problem, fit))

    def _of_surfaces(self, pairs: int, fit: Fit[Network], problem: NetworkProblem) -> tuple[NoiseLevels, "Weights"]:
        """By what the heights of planes leave of the residuals; with the likeliest steepness of these."""
        solved = [surface.solved(fit.state) for surface in self.surfaces]
        steepness, determined = likeliest_steepness(self.surfaces, solved, problem.covariance(fit))
        remaining = [
            (sight, residual)
            for surface, heights in zip(self.surfaces, solved, strict=True)
            for sight, residual in zip(surface.sights, heights.left, strict=True)
        ]
        absorbed = (np.count_nonzero(problem.free) + determined) / len(problem.parts)
        stations = []
        for capture in range(pairs):
            own = [(sight.cells, residual) for sight, residual in remaining if sight.capture == capture]
            sighted, residuals = [cells for cells, _ in own], [residual for _, residual in own]
            stations.append(of_station(sighted, residuals, absorbed)[0] if own else UNKNOWN)
        levels = NoiseLevels(tuple(stations), np.ones(len(fit.state.planes)), 1.0)
        surfaces = [
            replace(surface, steepness=steep, variances=tuple(levels.variances(surface.sights)))
            for surface, steep in zip(self.surfaces, steepness, strict=True)
        ]
        return levels, Weights(replace(problem, variances=levels.variances(problem.parts)), surfaces)

    def fitted(self, network: Network, tolerance: float) -> Fit[Network]:
        """The most likely network near one."""
        problem = self.problem
        if not self.surfaces:
            return problem.minimise(network, tolerance=tolerance)
        uneven = replace(problem, parts=(), variances=(), joints=(*self.surfaces, *problem.joints))
        fit = uneven.minimise(network, tolerance=tolerance)
        residuals = (sight.predict(fit.state)[0] - sight.cells.projector_px for sight in problem.parts)
        return replace(fit, residuals=tuple(residuals))
