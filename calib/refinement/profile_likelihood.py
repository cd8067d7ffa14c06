"""The likelihood along the camera's focal length, everything else being at its best: where the answer is uncertain.

The valley is curved, and in a view that determines little it is long. A covariance from the curvature at its lowest
point is then too small for whatever bends away. So the valley is walked, and the covariance is that of the posterior:
across the valley as its curvature says, along it as its cost says.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats
from calib.refinement.focal_sweep import at_focal
from calib.refinement.likelihood import Fit, Prior
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import CAMERA, State
from calib.refinement.profile_minimiser import relax

_STEP_SIGMAS = 0.7
_LONGEST_STEP = 0.08  # of log f
_STEPS = 14
_HIGHEST = 14.0
_GROWTH = 1.15


@dataclass(frozen=True)
class Valley:
    """States along the valley, by growing focal: `focal_px` (n,), `cost` (n,) above the lowest, and the states."""

    focal_px: Floats
    cost: Floats
    states: tuple[State, ...]

    def covariance(self, best: Fit, free: Bools) -> Floats:
        """Of all columns around the best state, (size, size); zero for columns that are not free."""
        across = free.copy()
        across[CAMERA.start] = False
        weight, steps = self.along(best)
        covariance: Floats = (steps * weight[:, None]).T @ steps + covariance_of(best.information, across)
        return covariance

    def along(self, best: Fit) -> tuple[Floats, Floats]:
        """The posterior along the valley: probabilities (n,) of its states, and the steps (n, size) to them."""
        steps = np.stack([best.state.step_to(state) for state in self.states])
        weight = np.exp(-self.cost / 2) * np.gradient(np.log(self.focal_px))
        return weight / weight.sum(), steps


def walk(captures: Sequence[Cells], best: Fit, prior: Prior, variances: Sequence[Floats]) -> Valley:
    """Both ways from the best fit, until the cost is clearly higher.

    Raises LinAlgError if no other focal length has an answer: nothing tells then how sure the best one is.
    """
    anchored = prior.holding(CAMERA.start)
    sigma = float(np.sqrt(covariance_of(best.information, prior.free)[CAMERA.start, CAMERA.start]))
    walked = [best]
    for direction in (-1.0, 1.0):
        fit, step = best, min(_STEP_SIGMAS * sigma, _LONGEST_STEP)
        for _ in range(_STEPS):
            focal = float(fit.state.camera[0]) * np.exp(direction * step)
            fit = relax(captures, at_focal(fit.state, focal), anchored, variances)
            if not np.isfinite(fit.cost):
                break
            walked.append(fit)
            if fit.cost - best.cost > _HIGHEST:
                break
            step = min(step * _GROWTH, _LONGEST_STEP)
    if len(walked) == 1:
        raise np.linalg.LinAlgError("no other focal length has an answer")
    walked.sort(key=lambda fit: float(fit.state.camera[0]))
    cost = np.array([fit.cost for fit in walked])
    states = tuple(fit.state for fit in walked)
    return Valley(np.array([state.camera[0] for state in states]), cost - cost.min(), states)


def covariance_of(information: Floats, free: Bools) -> Floats:
    """Inverse of the information on the free columns, (size, size), zero elsewhere."""
    covariance = np.zeros_like(information)
    chosen = np.ix_(free, free)
    covariance[chosen] = inverse_of(information[chosen])
    return covariance


def inverse_of(matrix: Floats) -> Floats:
    """Pseudo-inverse of a symmetric matrix (n, n) whose columns have very different scales."""
    scale = np.sqrt(np.diag(matrix))
    inverse: Floats = np.linalg.pinv(matrix / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    return inverse
