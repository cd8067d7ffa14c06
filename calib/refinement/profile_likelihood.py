"""The posterior along the camera's focal length, the least determined direction, from the profile likelihood.

The valley of the cost is curved, and long if a view determines little. A covariance from the curvature at its minimum
is then too small. So the valley is traced, and the covariance is that of the posterior: across the valley from the
curvature of the cost, along it from the cost and the width of the valley. A sigma along the valley is half the central
68 % interval, or a quarter of the central 95 % interval where that is more: equal to the standard deviation for a
Gaussian, and otherwise insensitive to tails that are less probable than one in twenty.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, covariance_of
from calib.refinement.likelihood import CornerFit, CornerProblem, Prior
from calib.refinement.parameters import CAMERA, State
from calib.refinement.profile_minimiser import relax

_STEP_SIGMAS = 0.7
_LONGEST_STEP = 0.08  # of log f
_STEPS = 14
_HALVINGS = 3
_HIGHEST = 14.0
_GROWTH = 1.15
_FLAT = 0.2  # change in cost over a step below which the next step is twice as long
_TOLERANCE, _RELAXED = 1e-5, 100  # in cost; steps: there may be other narrow, long valleys across this one
_CENTRAL, _NEARLY_ALL = (0.1587, 0.8413), (0.0228, 0.9772)  # one and two standard deviations of a Gaussian
_CENTRED = 0.1  # sigmas: deviation from the median that counts as centred
_FINE = 500
_FLATTEST = 1e-15  # eigenvalue of a Hessian scaled to unit diagonal below which it is rounding error


@dataclass(frozen=True)
class Valley:
    """States along the valley, by growing focal: `focal_px` (n,), `cost` (n,) above the lowest, and the states.

    `log_volume` (n,): log of the posterior's integral across the valley, relative to its density at the floor. `gain`:
    cost of the fit where the trace began minus the lowest cost.
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

    def covariance(self, best: CornerFit, free: Bools) -> Floats:
        """Return the covariance (size, size) of all columns around the best state; zero for fixed columns."""
        across = free.copy()
        across[CAMERA.start] = False
        weight, steps = self.along(best)
        return (steps * weight[:, None]).T @ steps + covariance_of(best.information, across)

    @property
    def interval_px(self) -> tuple[float, float]:
        """The central 68 % of the camera's focal length."""
        low, high = self._quantiles(_CENTRAL)
        return float(low), float(high)

    @property
    def log_sigma(self) -> float:
        """The sigma of the log of the camera's focal length."""
        (low, high), (lowest, highest) = self._quantiles(_CENTRAL), self._quantiles(_NEARLY_ALL)
        return max(float(np.log(high / low)) / 2, float(np.log(highest / lowest)) / 4)

    @property
    def median_px(self) -> float:
        """Posterior median of the camera's focal length."""
        return float(self._quantiles((0.5,))[0])

    def _quantiles(self, shares: tuple[float, ...]) -> Floats:
        at = np.log(self.focal_px)
        fine = np.linspace(at[0], at[-1], _FINE)
        # The square root of a parabola is a straight line, so that few states suffice for interpolation.
        log_weight = np.interp(fine, at, self.log_volume) - np.interp(fine, at, np.sqrt(self.cost)) ** 2 / 2
        weight = np.exp(log_weight - log_weight.max())
        below = (np.cumsum(weight) - weight / 2) / weight.sum()
        return np.exp(np.interp(shares, below, fine))

    def along(self, best: CornerFit) -> tuple[Floats, Floats]:
        """Return the probabilities (n,) of the states along the valley, and the steps (n, size) to them.

        Steps are scaled so that the log of the focal length has its `log_sigma`.
        """
        steps = np.stack([best.state.step_to(state) for state in self.states])
        weight = np.exp(-self.posterior_cost / 2) * np.gradient(np.log(self.focal_px))
        weight /= weight.sum()
        scale = self.log_sigma / np.sqrt(weight @ steps[:, CAMERA.start] ** 2)
        return weight, scale * steps


def trace_valley(problem: CornerProblem, best: CornerFit) -> Valley:
    """Trace the valley in both directions from the best fit until the cost is clearly higher.

    Raises LinAlgError if no other focal length has a solution: the uncertainty cannot be determined then.
    """
    anchored = problem.prior.holding(CAMERA.start)
    sigma = float(np.sqrt(problem.covariance(best)[CAMERA.start, CAMERA.start]))
    walked = [best]
    for direction in (-1.0, 1.0):
        fit, step = best, min(_STEP_SIGMAS * sigma, _LONGEST_STEP)
        for _ in range(_STEPS):
            last = fit
            ahead = problem.covariance(last)[:, CAMERA.start]
            for _ in range(_HALVINGS):
                along = last.state.moved(direction * step / ahead[CAMERA.start] * ahead)
                scaled = problem.under(anchored.for_focals_of(along, best.state))
                fit = relax(scaled, along, tolerance=_TOLERANCE, steps=_RELAXED)
                if fit.cost - last.cost < _HIGHEST:
                    break
                step /= 2  # too long for the valley's curvature, or beyond the last solution
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
    log_volume = np.array([log_volume_across(fit, best.state, problem.prior) for fit in walked])
    focal_px = np.array([state.camera[0] for state in states])
    return Valley(focal_px, cost - cost.min(), states, log_volume - log_volume.max(), float(best.cost - cost.min()))


def centred(problem: CornerProblem, best: CornerFit, valley: Valley) -> CornerFit:
    """Return the fit at the posterior median; in a long valley the lowest cost is often far from it."""
    middle = valley.median_px
    shift = np.log(middle / best.state.camera[0])
    if abs(shift) < _CENTRED * valley.log_sigma:
        return best
    nearest = valley.states[int(np.argmin(np.abs(np.log(valley.focal_px / middle))))]
    step = np.zeros(best.state.size)
    step[CAMERA.start] = np.log(middle / nearest.camera[0])
    start = nearest.moved(step)
    anchored = problem.prior.holding(CAMERA.start).for_focals_of(start, best.state)
    return relax(problem.under(anchored), start, tolerance=_TOLERANCE, steps=_RELAXED)


def log_volume_across(fit: CornerFit, best: State, prior: Prior) -> float:
    """Return the log volume of the posterior across the valley at a fit: Laplace's approximation, −½ log det Hessian.

    Of radial terms it is that of k1 / f², k2 / f⁴ and k3 / f⁶, to which distortion of the image is proportional. Short
    and long lenses distort their images equally; in the terms themselves longer lenses would be more likely only
    because their terms are larger numbers. So `trace_valley` scales the prior of these terms with the focal length.
    """
    scale = prior.radial_scale(fit.state, best)
    information = fit.information * np.outer(scale, scale)
    across = prior.free.copy()
    across[CAMERA.start] = False
    return -_log_determinant(information[np.ix_(across, across)]) / 2


def _log_determinant(matrix: Floats) -> float:
    """Return log det of a non-negative matrix (n, n) whose columns have very different scales."""
    unit = np.sqrt(np.diag(matrix))
    curvatures = np.maximum(np.linalg.eigvalsh(matrix / np.outer(unit, unit)), _FLATTEST)
    return float(np.sum(np.log(curvatures)) + 2 * np.sum(np.log(unit)))
