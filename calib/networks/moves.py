"""A device that was moved between its captures, weighed against other explanations of what does not fit together.

A device that stood elsewhere for one capture is a device more, with the same lens. Planes that captures do not share
after all, or pictures that are warped, may fit as well, with more parameters: so explanations are compared by the
Bayesian information criterion (Schwarz 1978, Annals of Statistics 6, 461), of the noise that each leaves, with as many
observations as there are independent ones among the cells.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import Fit, Term, long_waves
from calib.geometry import PER_PLANE, PER_POSE
from calib.networks.initialisation import ROUGH, Grown
from calib.networks.network import Network
from calib.networks.observations import PlaneObservation
from calib.numerics import CUBIC
from calib.refinement import PER_DEVICE

_SAME = np.array([1e-5, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])  # of log f, x_0, y_0, k1, k2, p1, p2, k3
_FAR_LIKELIER = 10.0  # of the criterion: odds of 150 to 1
_USUAL = 1.0, 99.0  # percentiles of residuals; beyond are outliers


@dataclass(frozen=True)
class SameLens:
    """Two devices, by number, that are one in two places."""

    one: int
    other: int

    def misfit(self, network: Network) -> Term:
        """Of the difference of both lenses."""
        first, second = (network.devices[device].lens for device in (self.one, self.other))
        off = np.array([np.log(second[0] / first[0]), *(second - first)[1:]]) / _SAME
        columns = [np.r_[network.device_columns(device)][:PER_DEVICE] for device in (self.one, self.other)]
        return Term.gaussian(np.concatenate(columns), off, np.hstack([-np.diag(1 / _SAME), np.diag(1 / _SAME)]))


@dataclass(frozen=True, eq=False)
class Explanation:
    """Why captures do not fit together: `fit` of the `sights` under the scatter of matches, with so many `parameters`
    more than if nothing were wrong. `moved`: the device that was moved, if that is it.
    """

    fit: Fit[Network]
    sights: Sequence[PlaneObservation]
    parameters: int
    moved: str = ""


def moves(grown: Grown, sights: Sequence[PlaneObservation], network: Network) -> Iterator[Explanation]:
    """Each device that has several captures, moved for one of them; fitted from near a network without a move."""
    for capture, pair in enumerate(grown.labelled):
        planes = sum(sight.capture == capture for sight in sights)
        for role, name in enumerate(pair):
            number, elsewhere = grown.names.index(name), len(grown.names)
            if not planes or {s.capture for s in sights if number in (s.camera, s.projector)} == {capture}:
                continue
            split = [_with_device(s, role, elsewhere) if s.capture == capture else s for s in sights]
            doubled = replace(network, devices=(*network.devices, network.devices[number]))
            more = replace(grown, names=(*grown.names, name))
            problem = replace(more.problem(doubled, split), joints=(SameLens(number, elsewhere),))
            fit = problem.minimise(doubled, tolerance=ROUGH)
            # A plane tells no more of where a device is than three numbers, its own.
            yield Explanation(fit, split, min(PER_POSE, PER_PLANE * planes), name)


def _with_device(sight: PlaneObservation, role: int, number: int) -> PlaneObservation:
    return replace(sight, projector=number) if role else replace(sight, camera=number)


def likeliest(usual: Explanation, others: Sequence[Explanation]) -> Explanation:
    """The one of the least criterion; `usual`, unless another one is likelier by far."""
    count = _independent(min([usual, *others], key=lambda explanation: explanation.fit.cost))

    def criterion(explanation: Explanation) -> float:
        return count * math.log(explanation.fit.cost) + explanation.parameters * math.log(count)

    best = min(others, key=criterion, default=usual)
    return best if criterion(best) < criterion(usual) - _FAR_LIKELIER else usual


def _independent(explanation: Explanation) -> float:
    """Number of independent coordinates among those of all cells: errors of neighbours are alike where waves of walls,
    or lenses, make them, which polynomials over a sight tell.
    """
    count = 0.0
    for sight, residual in zip(explanation.sights, explanation.fit.residuals, strict=True):
        off = np.clip(residual, *np.percentile(residual, _USUAL, axis=0))
        square = np.mean((off / sight.cells.sigma_px[:, None]) ** 2)
        smooth = long_waves(sight.cells, off, square * sight.cells.sigma_px**2)[0][0] / (2 * CUBIC)
        count += 2 * len(off) / max(smooth, 1.0) if np.isfinite(smooth) else PER_PLANE
    return max(count, 2.0)
