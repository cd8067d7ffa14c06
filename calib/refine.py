"""Maximum-likelihood refinement of one rig from one or more captures, started from the paper's one-dimensional family.

At each focal of a sweep the paper's transfer gives a start and everything else converges in a few steps. Every minimum
of that profile is then refined with the focal free, and all of them are compared. How noisy the matches are, and how
many terms the lenses have, is measured on the way.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats
from calib.cells import Cells
from calib.corner import Corner
from calib.descent import minimise, relax
from calib.lens_order import LensOrder, choose_lens_order
from calib.likelihood import Fit, Knowledge, Prior, evaluate
from calib.model import CAMERA, State
from calib.noise import Noise, noise_of
from calib.paper import Objective
from calib.same_corner import Sameness, tie
from calib.sweep import HOPELESS, SWEEP_CELLS, at_focal, minima, sweep_jointly, sweep_one

_SAME_SOLUTION = 0.01  # of log f: minima that converge this close are one
_LIKELIHOOD_ROUNDS = 3
_PROFILE_RANGE = 0.3  # of log f: within it the profile is exact
_PROFILE_SIGMAS = (-4.0, -2.5, -1.5, -0.75, 0.0, 0.75, 1.5, 2.5, 4.0)


@dataclass(frozen=True)
class Refinement:
    """The refined solution and what is known of it.

    `captures`: the cells, labelled alike where they show one corner; `noise` of each; `variances` (M,) of each cell.
    `prior`: of the final fit, lens terms that are left out being known to be zero. `covariance` (size, size) in the
    model's columns, zero for fixed ones. `others`: further minima, best first. `profile_focal_px`, `profile_cost` (n,):
    the cost along the camera's focal length, above the best. `sameness`: whether the captures show one corner.
    """

    captures: tuple[Cells, ...]
    noise: tuple[Noise, ...]
    variances: tuple[Floats, ...]
    prior: Prior
    fit: Fit
    covariance: Floats
    others: tuple[Fit, ...]
    lens_order: LensOrder
    profile_focal_px: Floats
    profile_cost: Floats
    sameness: Sameness | None

    def corner(self, capture: int) -> Corner:
        """The corner in the camera's frame of a capture, in baselines."""
        return Corner(self.fit.state.poses[capture].vertex, self.fit.state.legs(capture))


def refine(
    captures: Sequence[Cells], objectives: Sequence[Objective], focal_px: Floats, knowledge: Knowledge, *, same: bool
) -> Refinement | None:
    """Sweep the trial focals (n,), refine every minimum, compare. None where no trial gives real corners.

    `same`: several captures are taken to show one corner, unless their residuals tell otherwise.
    """
    thinned = [cells[:: max(1, len(cells) // SWEEP_CELLS)] for cells in captures]
    alone = [sweep_one(*pair, focal_px, knowledge) for pair in zip(thinned, objectives, strict=True)]
    sweep = alone[0] if len(captures) == 1 else sweep_jointly(thinned, alone, focal_px, knowledge)
    starts = minima(sweep)
    if not starts:
        return None
    fits = _explore(thinned, starts, knowledge)
    sameness = None
    if same and len(captures) > 1:
        captures, fits, sameness = tie(captures, thinned, fits, knowledge)

    variances = [_level(residual) for residual in _residuals(captures, fits[0])]
    for _ in range(_LIKELIHOOD_ROUNDS):
        prior = knowledge.prior(fits[0].state)
        fits = _distinct([minimise(captures, fit.state, prior, variances) for fit in fits])
        absorbed = np.count_nonzero(prior.free) / len(captures)
        noise = [noise_of(*pair, absorbed) for pair in zip(captures, fits[0].residuals, strict=True)]
        variances = [level.variances(cells) for cells, level in zip(captures, noise, strict=True)]
    best, *others = fits

    lens_order = choose_lens_order(best, covariance_of(best.information, prior.free), prior)
    for column in lens_order.zero:
        prior = prior.with_known(column)
    best = minimise(captures, _without(best.state, lens_order.zero), prior, variances)
    return Refinement(
        tuple(captures),
        tuple(noise),
        tuple(variances),
        prior,
        best,
        covariance_of(best.information, prior.free) + lens_order.spread,
        tuple(others),
        lens_order,
        *_profile(captures, [fit.state.camera[0] for fit in sweep if fit], best, prior, variances),
        sameness,
    )


def covariance_of(information: Floats, free: Bools) -> Floats:
    """Inverse of the information on the free columns, by way of unit diagonals, (size, size)."""
    chosen = np.ix_(free, free)
    scale = np.sqrt(np.diag(information)[free])
    covariance = np.zeros_like(information)
    covariance[chosen] = np.linalg.pinv(information[chosen] / np.outer(scale, scale), hermitian=True) / np.outer(
        scale, scale
    )
    return covariance


def _explore(captures: Sequence[Cells], starts: list[Fit], knowledge: Knowledge) -> list[Fit]:
    """The different minima, best first, that the starts (best first) lead to and that deserve a closer look."""
    prior = knowledge.prior(starts[0].state)
    variances = [_level(residual) for residual in starts[0].residuals]
    best = minimise(captures, starts[0].state, prior, variances)
    ceiling = HOPELESS * best.cost
    fits = _distinct([best, *(minimise(captures, fit.state, prior, variances, ceiling) for fit in starts[1:])])
    return [fit for fit in fits if fit.cost <= HOPELESS * fits[0].cost]


def _residuals(captures: Sequence[Cells], fit: Fit) -> tuple[Floats, ...]:
    """Residuals of a fit to thinned captures at all cells."""
    prior = Prior(np.zeros(fit.state.size), np.full(fit.state.size, np.inf))
    return evaluate(captures, fit.state, prior, [np.ones(len(cells)) for cells in captures]).residuals


def _level(residual: Floats) -> Floats:
    """One variance (M,) for all cells: that of residuals (M, 2)."""
    return np.full(len(residual), max(float(np.mean(residual**2)), 1e-12))


def _distinct(fits: list[Fit]) -> list[Fit]:
    """Different solutions, best first."""
    distinct: list[Fit] = []
    for fit in sorted((fit for fit in fits if np.isfinite(fit.cost)), key=lambda fit: fit.cost):
        if all(abs(np.log(fit.state.camera[0] / other.state.camera[0])) > _SAME_SOLUTION for other in distinct):
            distinct.append(fit)
    return distinct


def _without(state: State, zero: tuple[int, ...]) -> State:
    """A state with some columns set to zero."""
    step = np.zeros(state.size)
    step[list(zero)] = -state.additive()[list(zero)]
    return state.moved(step)


def _profile(
    captures: Sequence[Cells], swept: list[float], best: Fit, prior: Prior, variances: Sequence[Floats]
) -> tuple[Floats, Floats]:
    """Focals (n,) around the best and the cost there above the lowest, everything else being at its best."""
    anchored = prior.with_known(CAMERA.start)
    middle = float(best.state.camera[0])
    sigma = float(np.sqrt(covariance_of(best.information, prior.free)[CAMERA.start, CAMERA.start]))
    near = middle * np.exp(min(sigma, _PROFILE_RANGE / 4) * np.array(_PROFILE_SIGMAS))
    around = np.array([focal for focal in swept if abs(np.log(focal / middle)) < _PROFILE_RANGE])
    trials = np.concatenate([near, around])
    fits = []
    for side in (np.sort(trials[trials >= middle]), -np.sort(-trials[trials < middle])):
        state = best.state
        for focal in side:
            fits.append(relax(captures, at_focal(state, float(focal)), anchored, variances))
            state = fits[-1].state
    fits.sort(key=lambda fit: float(fit.state.camera[0]))
    cost = np.array([fit.cost for fit in fits])
    return np.array([fit.state.camera[0] for fit in fits]), cost - cost.min()
