"""Walls that are not flat: heights of a plane, which all pairs that see it share, with a prior, eliminated.

Heights are random waves over the visible part of a plane, longer ones being higher, as in
`calib.estimation.systematic_errors`. Their amplitudes have a Gaussian prior and are eliminated from the normal
equations, as if the waves' covariance were in that of the cells. The variance of amplitudes is that of the largest
evidence (MacKay, "Bayesian interpolation", Neural Computation 4, 1992), of each plane as far as it tells it, and else
of all planes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import ROBUST_SIGMAS, Fit, Term, modes_over
from calib.networks.network import Network
from calib.networks.observations import NetworkProblem, PlaneObservation
from calib.numerics import Floats, huber_loss, huber_weights

_ROUNDS = 3
_BEHIND = 100.0
_MARGIN = 0.2  # of the longer side: within, waves end as they like, where cosines are level at their ends
_AS_ALL = 3.0  # waves that all planes count as in the variance of one


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
            left = []
            for off, jacobian, good, variance, modes, own in sights:
                by_height = jacobian[:, :, -1]
                rest = off + by_height * (modes @ amplitudes)[:, None]
                left.append(rest)
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
        return Heights(amplitudes, inverse, across, tuple(left), Term(cost, slope, information, columns))


@dataclass(frozen=True, eq=False)
class Heights:
    """`amplitudes` (K,), their covariance (K, K) `alone`, if the network were known, and what they have in common with
    the network's columns that the misfit depends on, (K, Q). `left`: residuals (M, 2) of each sight.
    """

    amplitudes: Floats
    alone: Floats
    across: Floats
    left: tuple[Floats, ...]
    misfit: Term

    def told(self, steepness: float, covariance: Floats) -> float:
        """How many amplitudes the cells tell, under the `covariance` (size, size) of the network."""
        by_network, columns = self.alone @ self.across, self.misfit.columns
        whole = np.trace(self.alone) + np.sum(by_network @ covariance[np.ix_(columns, columns)] * by_network)
        return max(len(self.amplitudes) - float(whole) / steepness**2, 0.0)


def surfaces_of(problem: NetworkProblem, fit: Fit[Network]) -> tuple[PlaneRelief, ...]:
    """All planes, with heights that are as steep as residuals along them allow."""
    sights, variances = problem.parts, problem.variances
    found = []
    squares = []
    for plane, flat in enumerate(fit.state.planes):
        own = [i for i, sight in enumerate(sights) if sight.plane == plane]
        modes = modes_over([sights[i].points(fit.state) for i in own], flat.normal, _MARGIN)
        found.append(PlaneRelief(tuple(sights[i] for i in own), tuple(variances[i] for i in own), tuple(modes), 1.0))
        for i, each in zip(own, modes, strict=True):
            by_height = sights[i].predict(fit.state)[1][:, :, -1]
            heights = np.sum(by_height * fit.residuals[i], axis=1) / np.sum(by_height**2, axis=1)
            squares.append(np.median(heights**2) / np.mean(np.sum(each**2, axis=1)))
    steepness = float(np.sqrt(4 * np.max(squares)))
    return tuple(replace(each, steepness=steepness) for each in found)


def likeliest_steepness(
    surfaces: Sequence[PlaneRelief], solved: Sequence[Heights], covariance: Floats
) -> tuple[list[float], float]:
    """Of each; and how many amplitudes the cells tell of all of them. `covariance` (size, size): of the network."""
    told = [heights.told(each.steepness, covariance) for each, heights in zip(surfaces, solved, strict=True)]
    squares = [float(heights.amplitudes @ heights.amplitudes) for heights in solved]
    of_all = _AS_ALL * sum(squares) / max(sum(told), 1e-9)
    steepness = [
        float(np.sqrt((square + of_all) / (each + _AS_ALL))) for square, each in zip(squares, told, strict=True)
    ]
    return steepness, sum(told)
