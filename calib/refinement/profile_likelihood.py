"""The posterior along the camera's focal length, from the likelihood with everything else at its best: where the answer
is uncertain.

The valley is curved, and in a view that determines little it is long. A covariance from the curvature at its lowest
point is then too small for whatever bends away. So the valley is walked, and the covariance is that of the posterior:
across the valley as its curvature says, along it as its cost and its width say. Along it a sigma is half the central
68 % interval: of a Gaussian the standard deviation, and of anything else not ruled by what is improbable and far away.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import Bools, Floats
from calib.refinement.likelihood import Fit, Prior
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import CAMERA, State
from calib.refinement.profile_minimiser import relax

_STEP_SIGMAS = 0.7
_LONGEST_STEP = 0.08  # of log f
_STEPS = 14
_HALVINGS = 3
_HIGHEST = 14.0
_GROWTH = 1.15
_FLAT = 0.2  # in cost, of a step: the next is twice as long
_TOLERANCE, _RELAXED = 1e-5, 100  # in cost, steps: across the valley there may be others, as narrow and as long
_CENTRAL = 0.1587, 0.8413
_CENTRED = 0.1  # sigmas: closer to the middle than this is in the middle
_FINE = 500
_FLATTEST = 1e-15  # of a Hessian of unit diagonal: what is less is rounding


@dataclass(frozen=True)
class Valley:
    """States along the valley, by growing focal: `focal_px` (n,), `cost` (n,) above the lowest, and the states.

    `log_volume` (n,): how much of the posterior is across the valley there, its density at the floor being 1. `gain`:
    by how much the lowest cost is below that of the fit from which the valley was walked.
    """

    focal_px: Floats
    cost: Floats
    states: tuple[State, ...]
    log_volume: Floats
    gain: float = 0.0

    @property
    def lowest(self) -> State:
        """The state of the lowest cost."""
        return self.states[int(np.argmin(self.cost))]

    @property
    def posterior_cost(self) -> Floats:
        """−2 log of the posterior density of log f, above its lowest, (n,)."""
        cost = self.cost - 2 * self.log_volume
        above: Floats = cost - cost.min()
        return above

    def covariance(self, best: Fit, free: Bools) -> Floats:
        """Of all columns around the best state, (size, size); zero for columns that are not free."""
        across = free.copy()
        across[CAMERA.start] = False
        weight, steps = self.along(best)
        covariance: Floats = (steps * weight[:, None]).T @ steps + covariance_of(best.information, across)
        return covariance

    @property
    def interval_px(self) -> tuple[float, float]:
        """The central 68 % of the camera's focal length."""
        low, high = self._quantiles(_CENTRAL)
        return float(low), float(high)

    @property
    def median_px(self) -> float:
        """The camera's focal length that is as likely too short as too long."""
        return float(self._quantiles((0.5,))[0])

    def _quantiles(self, shares: tuple[float, ...]) -> Floats:
        at = np.log(self.focal_px)
        fine = np.linspace(at[0], at[-1], _FINE)
        # The root of a parabola is straight, so that few states tell the shape between them.
        log_weight = np.interp(fine, at, self.log_volume) - np.interp(fine, at, np.sqrt(self.cost)) ** 2 / 2
        weight = np.exp(log_weight - log_weight.max())
        below = (np.cumsum(weight) - weight / 2) / weight.sum()
        quantiles: Floats = np.exp(np.interp(shares, below, fine))
        return quantiles

    def along(self, best: Fit) -> tuple[Floats, Floats]:
        """The posterior along the valley: probabilities (n,) of its states, and the steps (n, size) to them.

        Steps are scaled so that the focal length's has the sigma of its central interval.
        """
        steps = np.stack([best.state.step_to(state) for state in self.states])
        weight = np.exp(-self.posterior_cost / 2) * np.gradient(np.log(self.focal_px))
        weight /= weight.sum()
        low, high = self.interval_px
        scale = np.log(high / low) / 2 / np.sqrt(weight @ steps[:, CAMERA.start] ** 2)
        return weight, scale * steps


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
            last = fit
            ahead = covariance_of(last.information, prior.free)[:, CAMERA.start]
            for _ in range(_HALVINGS):
                along = last.state.moved(direction * step / ahead[CAMERA.start] * ahead)
                fit = relax(captures, along, anchored, variances, tolerance=_TOLERANCE, steps=_RELAXED)
                if fit.cost - last.cost < _HIGHEST:
                    break
                step /= 2  # too long for the bend, or else a wall
            if not np.isfinite(fit.cost):
                break
            flat = fit.cost - last.cost < _FLAT
            walked.append(fit)
            if fit.cost - best.cost > _HIGHEST:
                break
            step = min(step * (2.0 if flat else _GROWTH), _LONGEST_STEP)
    if len(walked) == 1:
        raise np.linalg.LinAlgError("no other focal length has an answer")
    walked.sort(key=lambda fit: float(fit.state.camera[0]))
    cost = np.array([fit.cost for fit in walked])
    states = tuple(fit.state for fit in walked)
    log_volume = np.array([log_volume_across(fit, best.state, prior) for fit in walked])
    focal_px = np.array([state.camera[0] for state in states])
    return Valley(focal_px, cost - cost.min(), states, log_volume - log_volume.max(), float(best.cost - cost.min()))


def centred(captures: Sequence[Cells], best: Fit, valley: Valley, prior: Prior, variances: Sequence[Floats]) -> Fit:
    """The fit in the middle of the posterior along a long valley, whose lowest cost is often not near it."""
    middle = valley.median_px
    low, high = valley.interval_px
    shift = np.log(middle / best.state.camera[0])
    if abs(shift) < _CENTRED * np.log(high / low) / 2:
        return best
    nearest = valley.states[int(np.argmin(np.abs(np.log(valley.focal_px / middle))))]
    step = np.zeros(best.state.size)
    step[CAMERA.start] = np.log(middle / nearest.camera[0])
    anchored = prior.holding(CAMERA.start)
    return relax(captures, nearest.moved(step), anchored, variances, tolerance=_TOLERANCE, steps=_RELAXED)


def log_volume_across(fit: Fit, best: State, prior: Prior) -> float:
    """How much of the posterior is across the valley at a fit: Laplace's approximation, −½ log det of the Hessian.

    Radial terms bend the image in proportion to k1 / f², k2 / f⁴ and k3 / f⁶, and short and long lenses bend theirs
    alike. So the prior of those terms grows with the focal length as they do; one of fixed width would take a longer
    lens for likelier, only because its terms are larger numbers.
    """
    scale = prior.radial_scale(fit.state, best)
    grown = replace(prior, sigma=prior.sigma * scale)
    cost, _, curvature = prior.misfit(fit.state)
    grown_cost, _, grown_curvature = grown.misfit(fit.state)
    information = (fit.information + np.diag(grown_curvature - curvature)) * np.outer(scale, scale)
    across = prior.free.copy()
    across[CAMERA.start] = False
    chosen = information[np.ix_(across, across)]
    unit = np.sqrt(np.diag(chosen))
    curvatures = np.maximum(np.linalg.eigvalsh(chosen / np.outer(unit, unit)), _FLATTEST)
    log_determinant = np.sum(np.log(curvatures)) + 2 * np.sum(np.log(unit))
    return float(-(log_determinant + np.sum(grown_cost - cost)) / 2)


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
