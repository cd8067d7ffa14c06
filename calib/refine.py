"""Maximum-likelihood refinement over the true parameters, from a sweep of the paper's one-dimensional family.

Seen along the camera's focal length the likelihood is a flat valley with several minima (a twin whose focals are a
quarter too long can fit almost as well). So the focal is swept: at each trial the paper's transfer gives a start and
everything else converges in a few steps. Every minimum of that profile is then refined with the focal free, and all of
them are compared.

Minimised is Σ |r_i|² / (κ (σ_i² + τ²)) + Σ ((p − prior) / σ_prior)², r_i being the deviation of a cell of matches in
projector pixels; τ, what the model leaves unexplained beyond independent noise, and κ, the variance inflation of
residuals that are alike in neighbouring cells, are measured on the residuals themselves.
"""

from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats
from calib.cells import MEDIAN_LENGTH, Cells
from calib.corner import Corner
from calib.model import CAMERA, PER_CAPTURE, PROJECTOR, SHARED, SQUARENESS, Pose, State, predict
from calib.paper import Objective
from calib.transfer import Transfer

_SWEEP_CELLS = 300
_SWEEP_SIGMA_PX = 0.05  # what a decoder typically leaves unexplained; the measured value takes its place afterwards
_HOPELESS = 4.0  # minima with this many times the lowest cost are not followed
_SWEEP_TOLERANCE, _SWEEP_STEPS = 1.0, 10
_CONVERGED = 1e-4
_STEPS = 40
_DAMPING = 1e-7  # of a normal matrix scaled to unit diagonal
_LONGEST_STEP = 0.1  # of log f
_HALVINGS = 4
_PROFILE_RANGE = 0.3  # of log f: within it the profile is exact
_ROBUST_SIGMAS = 3.0
_SAME_SOLUTION = 0.01  # of log f: minima that converge this close are one
_LIKELIHOOD_ROUNDS = 4


@dataclass(frozen=True)
class Prior:
    """Gaussian prior on the additive columns of the model: `mean`, `sigma` (size,); 0 = known, infinity = unknown."""

    mean: Floats
    sigma: Floats

    @property
    def free(self) -> Bools:
        """Columns that are estimated, (size,)."""
        return self.sigma > 0

    def deviation(self, state: State) -> Floats:
        """(value − mean) / σ of each column, (size,); zero where the prior says nothing."""
        informative = self.free & np.isfinite(self.sigma)
        scale = np.where(informative, self.sigma, 1.0)
        return np.where(informative, (state.additive() - self.mean) / scale, 0.0)

    def precision(self) -> Floats:
        """1 / σ² of the free columns, 0 elsewhere, (size,)."""
        return np.where(self.free, 1.0 / np.where(self.free, self.sigma, 1.0) ** 2, 0.0)

    def with_known(self, column: int) -> "Prior":
        """The same with one column held fixed."""
        sigma = self.sigma.copy()
        sigma[column] = 0.0
        return Prior(self.mean, sigma)


@dataclass(frozen=True)
class Fit:
    """A state with its `cost`, `residual` (M, 2) in projector px, and half the cost's `gradient` and Hessian."""

    state: State
    cost: float
    residual: Floats
    gradient: Floats
    information: Floats


@dataclass(frozen=True)
class Refinement:
    """The refined solution and what is known of it.

    `covariance` (size, size) in the model's columns, zero for fixed ones. `others`: further minima, best first.
    `profile_focal_px`, `profile_cost` (n,): the cost along the camera's focal length, above the best.
    `systematic_px`: τ; `inflation`: κ.
    """

    fit: Fit
    covariance: Floats
    others: tuple[Fit, ...]
    profile_focal_px: Floats
    profile_cost: Floats
    systematic_px: float
    inflation: float

    @property
    def corner(self) -> Corner:
        """The corner in the camera's frame, in baselines."""
        return Corner(self.fit.state.poses[0].vertex, self.fit.state.legs())


@dataclass(frozen=True)
class Knowledge:
    """What is known before the matches are seen: image sizes (width, height), the camera's principal point with its
    standard deviation (0: exactly known), and how square the corner is (standard deviation of its angles; 0: exactly).
    """

    camera_size: tuple[int, int]
    projector_size: tuple[int, int]
    principal_point_px: tuple[float, float]
    principal_point_sigma_px: float
    squareness_deg: float

    def prior(self, captures: int = 1) -> Prior:
        """As a prior on the model's columns.

        Beside what is known of this rig, what holds for any lens that is sold: focals of one image width within a
        factor of two, a projector's principal point within half an image height of the centre, k1 within 0.1 and k2
        within 0.03 of zero (1 sigma each). A capture that determines the focals to a few per cent does not feel it.
        """
        size = SHARED + PER_CAPTURE * captures
        mean, sigma = np.zeros(size), np.full(size, np.inf)
        for device, (width, height) in ((CAMERA, self.camera_size), (PROJECTOR, self.projector_size)):
            mean[device] = [np.log(1.2 * width), (width - 1) / 2, (height - 1) / 2, 0.0, 0.0]
            sigma[device] = [0.7, height / 2, height / 2, 0.1, 0.03]
        centre = slice(CAMERA.start + 1, CAMERA.start + 3)
        mean[centre], sigma[centre] = self.principal_point_px, self.principal_point_sigma_px
        sigma[SQUARENESS] = np.radians(self.squareness_deg)
        return Prior(mean, sigma)


def refine(cells: Cells, objective: Objective, focal_px: Floats, knowledge: Knowledge) -> Refinement | None:
    """Sweep the trial focals (n,), refine every minimum, compare. None where no trial gives a real corner."""
    thinned = cells[:: max(1, len(cells) // _SWEEP_CELLS)]
    prior = knowledge.prior()
    sweep = _sweep(thinned, objective, focal_px, prior)
    if not sweep:
        return None

    fits = _explore(thinned, _minima(sweep), prior)
    systematic, inflation = 0.0, 1.0
    variance = np.full(len(cells), max(float(np.mean(fits[0].residual ** 2)), 1e-12))
    for _ in range(_LIKELIHOOD_ROUNDS):
        fits = _distinct([minimise(cells, fit.state, prior, variance * inflation) for fit in fits])
        residual = fits[0].residual
        systematic = _systematic(residual, cells.sigma_px)
        variance = cells.sigma_px**2 + systematic**2
        inflation = _inflation(cells, residual / np.sqrt(variance)[:, None])
    best, *others = fits

    profile = _profile(cells, sweep, best, prior, variance * inflation)
    return Refinement(
        best,
        _covariance(best.information, prior.free),
        tuple(others),
        *profile,
        systematic,
        inflation,
    )


def _explore(cells: Cells, starts: list[Fit], prior: Prior) -> list[Fit]:
    """The different minima, best first, that the starts (best first) lead to and that deserve a closer look."""
    variance = np.full(len(cells), max(float(np.mean(starts[0].residual ** 2)), 1e-12))
    best = minimise(cells, starts[0].state, prior, variance)
    ceiling = _HOPELESS * best.cost
    fits = _distinct([best, *(minimise(cells, fit.state, prior, variance, ceiling) for fit in starts[1:])])
    return [fit for fit in fits if fit.cost <= _HOPELESS * fits[0].cost]


def minimise(cells: Cells, state: State, prior: Prior, variance: Floats, ceiling: float = np.inf) -> Fit:
    """The nearest minimum, down the profile along the camera's focal; `variance` (M,) of each coordinate of each cell.

    Given up where the cost would stay above `ceiling`.

    The valley is curved: a joint step soon leaves it, and the many small ones that stay in it look like convergence.
    So after each joint Newton step everything but the focal is relaxed back to the valley's floor, along which the
    cost is nearly a parabola.
    """
    anchored = prior.with_known(CAMERA.start)
    fit = relax(cells, state, anchored, variance)
    for _ in range(_STEPS):
        step, decrement = _newton(fit, prior, 0.0)
        if not np.isfinite(fit.cost) or decrement < _CONVERGED or fit.cost - decrement > ceiling:
            break
        step *= min(1.0, _LONGEST_STEP / max(abs(step[CAMERA.start]), 1e-12))
        for _ in range(_HALVINGS):
            trial = relax(cells, fit.state.moved(step), anchored, variance)
            if trial.cost <= fit.cost:
                break
            step /= 4
        else:
            break
        fit = trial
    return fit


def relax(
    cells: Cells, state: State, prior: Prior, variance: Floats, tolerance: float = _CONVERGED, steps: int = _STEPS
) -> Fit:
    """Levenberg–Marquardt over the free columns of the prior, with Huber weights.

    Ends when Newton's decrement, the cost that a full step promises to gain, falls below `tolerance`, or that share
    of a hundredth of the cost.
    """
    damping = _DAMPING
    fit = evaluate(cells, state, prior, variance)
    for _ in range(steps):
        step, decrement = _newton(fit, prior, damping)
        if not np.isfinite(fit.cost) or decrement < tolerance * (1 + 0.01 * fit.cost):
            break
        trial = evaluate(cells, fit.state.moved(step), prior, variance)
        if trial.cost <= fit.cost:
            fit = trial
            damping = max(damping / 30, 1e-14)
        elif damping > 1e4:
            break
        else:
            damping = 30 * damping
    return fit


def _newton(fit: Fit, prior: Prior, damping: float) -> tuple[Floats, float]:
    """The damped Gauss–Newton step (size,) over the free columns, and the gain that the undamped one promises."""
    free = np.flatnonzero(prior.free)
    normal = fit.information[np.ix_(free, free)]
    scale = np.sqrt(np.diag(normal)) + 1e-12
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    values = np.maximum(values, 1e-14)
    downhill = vectors.T @ (fit.gradient[free] / scale)
    step = np.zeros(len(prior.mean))
    step[free] = -(vectors @ (downhill / (values + damping))) / scale
    return step, float(np.sum(downhill**2 / values))


def evaluate(cells: Cells, state: State, prior: Prior, variance: Floats) -> Fit:
    """The cost of a state with its derivatives; infinite where points fall behind a device."""
    with np.errstate(all="ignore"):
        predicted, jacobian, depths = predict(state, cells.camera_px, cells.face)
    residual = predicted - cells.projector_px
    if not (np.isfinite(jacobian).all() and np.all(depths > 0)):
        return Fit(state, np.inf, residual, np.zeros(state.size), np.zeros((state.size, state.size)))
    size = np.linalg.norm(residual, axis=1) / np.sqrt(variance)
    robust = np.minimum(1.0, _ROBUST_SIGMAS / np.maximum(size, 1e-12))
    weight = np.repeat(robust / variance, 2)
    flat = jacobian.reshape(-1, state.size)
    weighted = flat * weight[:, None]
    # Huber's loss: the square up to the threshold, linear beyond it.
    loss = np.where(size <= _ROBUST_SIGMAS, size**2, 2 * _ROBUST_SIGMAS * size - _ROBUST_SIGMAS**2)
    deviation, precision = prior.deviation(state), prior.precision()
    return Fit(
        state,
        float(np.sum(loss) + np.sum(deviation**2)),
        residual,
        weighted.T @ residual.ravel() + deviation * np.sqrt(precision),
        flat.T @ weighted + np.diag(precision),
    )


def _sweep(cells: Cells, objective: Objective, focal_px: Floats, prior: Prior) -> list[Fit]:
    """The best fit with the focal held at each trial (n,), where there is one.

    Two starts for each: the paper's transfer, which may lie on another branch, and the fit at the trial before.
    """
    totals, transfers = objective.evaluate(focal_px)
    variance = np.full(len(cells), _SWEEP_SIGMA_PX**2)
    anchored = prior.with_known(CAMERA.start)
    fits: list[Fit] = []
    for trial, focal in enumerate(focal_px):
        starts = [
            _start(transfers, mirror * len(focal_px) + trial, float(focal), objective.principal_point_px)
            for mirror in (0, 1)
            if np.isfinite(totals[mirror, trial])
        ]
        candidates = sorted((evaluate(cells, start, anchored, variance) for start in starts), key=_cost)[:1]
        if fits:
            candidates.append(evaluate(cells, _at_focal(fits[-1].state, float(focal)), anchored, variance))
        relaxed = [relax(cells, fit.state, anchored, variance, _SWEEP_TOLERANCE, _SWEEP_STEPS) for fit in candidates]
        fits += [fit for fit in sorted(relaxed, key=_cost)[:1] if np.isfinite(fit.cost)]
    return fits


def _cost(fit: Fit) -> float:
    return fit.cost


def _start(transfers: Transfer, i: int, focal: float, principal_point_px: tuple[float, float]) -> State:
    """The paper's solution number i as a state: no lens terms, exactly square."""
    baseline = np.linalg.norm(transfers.translation[i])
    matrix = transfers.matrix[i]
    return State(
        np.array([focal, *principal_point_px, 0.0, 0.0]),
        np.array([np.sqrt(matrix[0, 0] * matrix[1, 1]), matrix[0, 2], matrix[1, 2], 0.0, 0.0]),
        transfers.rotation[i],
        transfers.translation[i] / baseline,
        np.zeros(3),
        (Pose(transfers.normals[i], transfers.vertex[i] / baseline),),
    )


def _at_focal(state: State, focal: float) -> State:
    """A state moved to another camera focal, the projector's in proportion."""
    step = np.zeros(state.size)
    step[CAMERA.start] = step[PROJECTOR.start] = np.log(focal / state.camera[0])
    return state.moved(step)


def _minima(sweep: list[Fit]) -> list[Fit]:
    """Local minima of a sweep along the focal length, ends included, best first, without the hopeless ones."""
    costs = np.array([np.inf, *(fit.cost for fit in sweep), np.inf])
    minima = [fit for i, fit in enumerate(sweep) if costs[i + 1] <= costs[i] and costs[i + 1] <= costs[i + 2]]
    minima.sort(key=_cost)
    return [fit for fit in minima if fit.cost <= _HOPELESS * (minima[0].cost + len(fit.residual))]


def _distinct(fits: list[Fit]) -> list[Fit]:
    """Different solutions, best first."""
    distinct: list[Fit] = []
    for fit in sorted((fit for fit in fits if np.isfinite(fit.cost)), key=_cost):
        if all(abs(np.log(fit.state.camera[0] / other.state.camera[0])) > _SAME_SOLUTION for other in distinct):
            distinct.append(fit)
    return distinct


def _systematic(residual: Floats, sigma_px: Floats) -> float:
    """τ such that the residuals (M, 2) have the median size that variances σ² + τ² predict (robust, in px)."""
    low, high = 0.0, 2 * float(np.median(np.linalg.norm(residual, axis=1))) + 1e-12
    for _ in range(50):
        middle = (low + high) / 2
        size = np.linalg.norm(residual, axis=1) / np.sqrt(sigma_px**2 + middle**2)
        low, high = (middle, high) if np.median(size) > MEDIAN_LENGTH else (low, middle)
    return high if high > 1e-3 * float(np.median(sigma_px)) else 0.0


def _inflation(cells: Cells, whitened: Floats) -> float:
    """Variance inflation κ = ((1 + ρ) / (1 − ρ))² of a field with correlation ρ to the next cell in both directions."""
    clipped = np.clip(whitened, -_ROBUST_SIGMAS, _ROBUST_SIGMAS)
    width = int(cells.column.max()) + 2
    height = int(cells.row.max()) + 2
    key = (cells.face.astype(np.int64) * height + cells.row) * width + cells.column
    order = np.argsort(key)
    products = []
    for step in (1, width):
        place = np.minimum(np.searchsorted(key[order], key + step), len(key) - 1)
        neighbour = order[place]
        found = key[neighbour] == key + step
        products.append(np.sum(clipped[found] * clipped[neighbour[found]], axis=1) / 2)
    power = float(np.mean(clipped**2))
    pairs = np.concatenate(products)
    rho = float(np.mean(pairs)) / power if len(pairs) and power > 0 else 0.0
    rho = min(max(rho, 0.0), 0.9)
    return ((1 + rho) / (1 - rho)) ** 2


def _covariance(information: Floats, free: Bools) -> Floats:
    """Inverse of the information on the free columns, by way of unit diagonals, (size, size)."""
    chosen = np.ix_(free, free)
    scale = np.sqrt(np.diag(information)[free])
    covariance = np.zeros_like(information)
    covariance[chosen] = np.linalg.pinv(information[chosen] / np.outer(scale, scale), hermitian=True) / np.outer(
        scale, scale
    )
    return covariance


def _profile(cells: Cells, sweep: list[Fit], best: Fit, prior: Prior, variance: Floats) -> tuple[Floats, Floats]:
    """Focals (n,) and the cost there above the lowest, at the final variances.

    Around the best, everything but the focal is at its best, found by continuation; further off it is as the sweep
    left it.
    """
    anchored = prior.with_known(CAMERA.start)
    middle = float(best.state.camera[0])
    sigma = float(np.sqrt(_covariance(best.information, prior.free)[CAMERA.start, CAMERA.start]))
    near = middle * np.exp(sigma * np.array([-5.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]))
    swept = np.array([fit.state.camera[0] for fit in sweep])
    around = swept[np.abs(np.log(swept / middle)) < _PROFILE_RANGE]
    fits = [evaluate(cells, fit.state, anchored, variance) for fit in sweep if fit.state.camera[0] not in around]
    trials = np.concatenate([near, around])
    for side in (np.sort(trials[trials >= middle]), -np.sort(-trials[trials < middle])):
        state = best.state
        for focal in side:
            fits.append(relax(cells, _at_focal(state, float(focal)), anchored, variance))
            state = fits[-1].state
    fits.sort(key=lambda fit: float(fit.state.camera[0]))
    cost = np.array([fit.cost for fit in fits])
    return np.array([fit.state.camera[0] for fit in fits]), cost - cost.min()
