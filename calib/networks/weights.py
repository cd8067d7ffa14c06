"""What a network is fitted with once its noise is measured.

Walls that are not flat: heights of a plane, which all pairs that see it share, with a prior, eliminated.

Heights are random waves over the visible part of a plane, longer ones being higher, as in
`calib.estimation.systematic_errors`. Their amplitudes have a Gaussian prior and are eliminated from the normal
equations, as if the waves' covariance were in that of the cells. The variance of amplitudes is that of the largest
evidence (MacKay, "Bayesian interpolation", Neural Computation 4, 1992), of each plane as far as it tells it, and else
of all planes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import ROBUST_SIGMAS, UNKNOWN, Fit, NoiseLevels, Term, measured, modes_over, of_station
from calib.networks.initialisation import Grown
from calib.networks.network import Network
from calib.networks.observations import NetworkProblem, PlaneObservation
from calib.numerics import Bools, Floats, huber_loss, huber_weights

_ROUNDS = 3
_BEHIND = 100.0
_MARGIN = 0.2  # of the longer side: within, waves end as they like, where cosines are level at their ends
_AS_ALL = 3.0  # waves that all planes count as in the variance of one
_BENT = 4.0  # times the variance of noise
_START = 3.0  # sigmas of the scatter of matches


@dataclass(frozen=True, eq=False)
class PlaneRelief:
    """All `sights` of one plane, (M,) `variances` of each one's cells, and `modes` (M, K) of heights there.

    `steepness`: standard deviation of their amplitudes.
    """

    sights: tuple[PlaneObservation, ...]
    variances: tuple[Floats, ...]
    modes: tuple[Floats, ...]
    steepness: float

    def misfit(self, network: Network) -> Term:
        """The cost at the likeliest heights."""
        return self.solved(network).misfit

    def solved(self, network: Network) -> "Heights":
        """The likeliest heights."""
        columns = np.unique(np.concatenate([sight.columns(network) for sight in self.sights]))
        count, size = self.modes[0].shape[1], len(columns)
        sights = []
        for sight, variance, modes in zip(self.sights, self.variances, self.modes, strict=True):
            predicted, jacobian, depths = sight.predict(network)
            off = predicted - sight.cells.projector_px
            good = (depths > 0).all(axis=1) & np.isfinite(jacobian.sum(axis=(1, 2)))
            off[~good], jacobian[~good] = 0.0, 0.0
            sights.append((off, jacobian, good, variance, modes, np.searchsorted(columns, sight.columns(network))))
        amplitudes, behind = np.zeros(count), sum(np.count_nonzero(~good) for _, _, good, *_ in sights)
        for last in range(_ROUNDS):
            cost = _BEHIND * behind + float(amplitudes @ amplitudes) / self.steepness**2
            normal, pull = np.eye(count) / self.steepness**2, np.zeros(count)
            across, slope, information = np.zeros((count, size)), np.zeros(size), np.zeros((size, size))
            residuals = []
            for off, jacobian, good, variance, modes, own in sights:
                by_height = jacobian[:, :, -1]
                rest = off + by_height * (modes @ amplitudes)[:, None]
                residuals.append(rest)
                deviation = np.linalg.norm(rest, axis=1) / np.sqrt(variance)
                cost += float(np.sum(huber_loss(deviation, ROBUST_SIGMAS)))
                weight = huber_weights(deviation, ROBUST_SIGMAS) * good / variance
                normal += (modes * (weight * np.sum(by_height**2, axis=1))[:, None]).T @ modes
                pull += modes.T @ (weight * np.sum(by_height * rest, axis=1))
                if last < _ROUNDS - 1:
                    continue
                by_column = np.einsum("na,nac->nc", by_height * weight[:, None], jacobian)
                across[:, own] += modes.T @ by_column
                rows = (jacobian * np.sqrt(weight)[:, None, None]).reshape(-1, jacobian.shape[2])
                slope[own] += rows.T @ (rest * np.sqrt(weight)[:, None]).ravel()
                information[np.ix_(own, own)] += rows.T @ rows
            if last < _ROUNDS - 1:
                amplitudes = amplitudes - np.linalg.solve(normal, pull + amplitudes / self.steepness**2)
        inverse: Floats = np.linalg.inv(normal).astype(np.float64)
        information -= across.T @ inverse @ across
        # The heights are nearly, not exactly, the likeliest.
        slope -= across.T @ (inverse @ (pull + amplitudes / self.steepness**2))
        return Heights(amplitudes, inverse, across, tuple(residuals), Term(cost, slope, information, columns))


@dataclass(frozen=True, eq=False)
class Heights:
    """`amplitudes` (K,), their covariance (K, K) `alone`, if the network were known, and what they have in common with
    the network's columns that the misfit depends on, (K, Q). `residuals`: (M, 2) of each sight.
    """

    amplitudes: Floats
    alone: Floats
    across: Floats
    residuals: tuple[Floats, ...]
    misfit: Term

    def told(self, steepness: float, covariance: Floats) -> float:
        """How many amplitudes the cells tell, under the `covariance` (size, size) of the network."""
        by_network, columns = self.alone @ self.across, self.misfit.columns
        whole = np.trace(self.alone) + np.sum(by_network @ covariance[np.ix_(columns, columns)] * by_network)
        return max(len(self.amplitudes) - float(whole) / steepness**2, 0.0)


def surfaces_of(problem: NetworkProblem, fit: Fit[Network]) -> tuple[PlaneRelief, ...]:
    """All planes, with heights that are as steep as residuals along them allow."""
    sights, variances = problem.parts, problem.variances
    reliefs = []
    squares = []
    for plane, flat in enumerate(fit.state.planes):
        own = [i for i, sight in enumerate(sights) if sight.plane == plane]
        modes = modes_over([sights[i].points(fit.state) for i in own], flat.normal, _MARGIN)
        reliefs.append(PlaneRelief(tuple(sights[i] for i in own), tuple(variances[i] for i in own), tuple(modes), 1.0))
        for i, sight_modes in zip(own, modes, strict=True):
            by_height = sights[i].predict(fit.state)[1][:, :, -1]
            heights = np.sum(by_height * fit.residuals[i], axis=1) / np.sum(by_height**2, axis=1)
            squares.append(np.median(heights**2) / np.mean(np.sum(sight_modes**2, axis=1)))
    steepness = float(np.sqrt(4 * np.max(squares)))
    return tuple(replace(relief, steepness=steepness) for relief in reliefs)


def likeliest_steepness(
    surfaces: Sequence[PlaneRelief], solved: Sequence[Heights], covariance: Floats
) -> tuple[list[float], float]:
    """Of each; and how many amplitudes the cells tell of all of them. `covariance` (size, size): of the network."""
    effective_counts = [
        heights.told(surface.steepness, covariance) for surface, heights in zip(surfaces, solved, strict=True)
    ]
    squares = [float(heights.amplitudes @ heights.amplitudes) for heights in solved]
    of_all = _AS_ALL * sum(squares) / max(sum(effective_counts), 1e-9)
    steepness = [
        float(np.sqrt((square + of_all) / (count + _AS_ALL)))
        for square, count in zip(squares, effective_counts, strict=True)
    ]
    return steepness, sum(effective_counts)


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
            for sight, residual in zip(surface.sights, heights.residuals, strict=True)
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
