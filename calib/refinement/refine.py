"""Maximum-likelihood refinement of one rig from one or more captures, started from the paper's one-dimensional family.

At each focal of a sweep the paper's transfer gives a start, and all other parameters converge in a few steps. Every
minimum of that profile is then refined with the focal free, and the minima are compared. The noise of the matches is
estimated from the residuals.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from calib.estimation import Cells, Noise, noise_of
from calib.geometry import Corner
from calib.numerics import Bools, Floats, distinct
from calib.refinement.alternatives import LargerModel, picture_scale
from calib.refinement.focal_sweep import HOPELESS, SWEEP_CELLS, Family, minima, sweep_jointly, sweep_one, twins
from calib.refinement.further_planes import mean_square, oblique_planes, unexplained, without
from calib.refinement.likelihood import CornerFit, CornerProblem, Knowledge, Prior
from calib.refinement.parameters import SHARED, State, intrinsic_distance
from calib.refinement.profile_likelihood import Valley, centred, trace_valley
from calib.refinement.profile_minimiser import minimise
from calib.refinement.scale_mixture import WeighedFit, weigh
from calib.refinement.shared_corner import Sameness, oriented, tie

# Cells of all captures and a state → the same with further planes.
Further = Callable[[Sequence[Cells], State], tuple[list[Cells], State]]

_SAME_SOLUTION = 0.01  # relative difference of focals and projector centre below which minima are the same
_NOISE_ROUNDS = 3
_ANY_ANGLE_DEG = 10.0
CLEARLY_WORSE = 9.0  # in cost, that is three sigmas
_STRAINED = 9.0  # cost of the assumption on the angles above which a fit without it is tried as well
_TRACES, _GAINED = 3, 0.3  # traces of a valley; gain in cost that justifies another one
_ROUGH = 0.3  # tolerance in cost where only residuals or costs are looked at


@dataclass(frozen=True)
class Refinement:
    """The refined solution with its diagnostics."""

    problem: CornerProblem
    """Of the final fit: the captures' cells, with consistent labels if they show one corner, and the prior."""
    noise: tuple[Noise, ...]
    """Of each capture."""
    fit: CornerFit
    """The solution."""
    covariance: Floats
    """(size, size) in the model's columns, zero for fixed ones."""
    others: tuple[CornerFit, ...]
    """Further minima, best first."""
    valley: Valley
    """The cost along the camera's focal length."""
    tension: float
    """Cost of the prior on the corner's angles."""
    sameness: Sameness | None
    """Whether the captures show one corner."""
    apart: CornerFit | None = None
    """The nearby fit of these captures alone, if there is a prior on the rig from other data."""
    scale: LargerModel | None = None
    """A projector's picture that is scaled along x; None if other data tell its pixels' shape."""

    @property
    def captures(self) -> tuple[Cells, ...]:
        """The cells of each capture."""
        return self.problem.captures

    @property
    def prior(self) -> Prior:
        """Of the final fit."""
        return self.problem.prior

    def corner(self, capture: int) -> Corner:
        """The corner in the camera's frame of a capture, in baselines."""
        return Corner(self.fit.state.corner(capture).vertex, self.fit.state.legs(capture))


def refine(
    captures: Sequence[Cells],
    families: Sequence[Family],
    focal_px: Floats,
    knowledge: Knowledge,
    *,
    same: bool,
    further: Further | None = None,
) -> Refinement | None:
    """Sweep the trial focals (n,), refine every minimum and compare them. None if no trial gives real corners.

    `same`: assume that all captures show one corner, unless their residuals contradict it. `further`: adds planes
    other than the corners' faces to captures and state.
    """
    thinned = [thin(cells) for cells in captures]
    alone = [sweep_one(*pair, focal_px, knowledge) for pair in zip(thinned, families, strict=True)]
    sweep = alone[0] if len(captures) == 1 else sweep_jointly(thinned, alone, focal_px, knowledge)
    starts = minima(sweep)
    if not starts:
        return None
    if len(captures) == 1:
        # The sweep keeps only the best solution at each focal; the other one is the corner turned inside out.
        starts += twins(thinned[0], families[0], starts[0], knowledge)
    fits = [oriented(thinned, fit) for fit in explore(thinned, starts, knowledge)]
    decentred: list[CornerFit] = []
    known = knowledge.of_decentred_lenses
    may_be_decentred = knowledge.rig is None and known.lenses != knowledge.lenses
    if may_be_decentred and len(captures) == 1 and knowledge.principal_point_sigma_px > 0:
        # One view hardly tells decentred lenses from a shifted principal point: some minima have such lenses alone.
        starts = minima(sweep_one(thinned[0], families[0], focal_px, known))
        decentred = [oriented(thinned, fit) for fit in explore(thinned, starts, known)] if starts else []
    sameness = None
    if same and len(captures) > 1:
        captures, fits, sameness = tie(captures, thinned, fits, knowledge)
    return settle(captures, fits, knowledge, decentred=decentred, sameness=sameness, further=further)


def thin(cells: Cells) -> Cells:
    """Return as few cells as a sweep needs."""
    return cells[:: max(1, len(cells) // SWEEP_CELLS)]


def settle(
    captures: Sequence[Cells],
    fits: Sequence[CornerFit],
    knowledge: Knowledge,
    *,
    decentred: Sequence[CornerFit] = (),
    sameness: Sameness | None = None,
    further: Further | None = None,
) -> Refinement | None:
    """Return the solution with its uncertainty, given different minima (best first) of some or all of the cells.

    `decentred`: minima for the most decentred lenses. None if no minimum remains with all cells.
    """
    # The noise is measured without the prior from other data: a contradiction to it must not count as noise.
    unassuming = replace(knowledge, squareness_deg=_ANY_ANGLE_DEG, rig=None).prior(fits[0].state)
    noise = _measured(captures, fits[0], unassuming)
    usual = _problem(captures, knowledge.prior(fits[0].state), noise)
    starts = [(usual, fit) for fit in fits]
    if decentred:
        odd = usual.under(knowledge.of_decentred_lenses.prior(fits[0].state))
        starts += [(odd, fit) for fit in decentred]
    weighed = _best_first([weigh(problem, fit.state) for problem, fit in starts])
    if not weighed:
        return None
    loose = minimise(_with_any_angles(weighed[0]), weighed[0].fit.state, tolerance=_ROUGH)
    # Starting from the fit with free angles, the prior on them may lead to another minimum.
    square = _squared(loose.state) if knowledge.squareness_deg == 0 else loose.state
    if weighed[0].fit.cost - loose.cost > _STRAINED:
        weighed = _best_first([*weighed, weigh(usual, square)])
    best, problem = weighed[0].fit, weighed[0].problem
    # What speaks against the others is their evidence; it is stated as if it were their cost.
    alternatives = [replace(minimum.fit, cost=best.cost + minimum.cost - weighed[0].cost) for minimum in weighed[1:]]
    tension = best.cost - loose.cost

    if further is not None and not any(alternative.cost < best.cost + CLEARLY_WORSE for alternative in alternatives):
        alternatives = []
        best, problem = _with_planes(captures, best, knowledge, noise, further)

    lowest, valley = _traced(problem, best)
    tension -= best.cost - lowest.cost
    best = centred(problem, lowest, valley)
    covariance = valley.covariance(best, problem.free)
    if sameness and sameness.same:
        covariance[:SHARED, :SHARED] += sameness.spread
    scale = None
    if knowledge.rig is None and not knowledge.one_camera:
        scale = picture_scale(problem, best)
        covariance += scale.added(scale.probability)
    apart = None
    if knowledge.rig is not None:
        of_any_rig = replace(knowledge, rig=None).prior(best.state)
        apart = minimise(problem.under(of_any_rig), best.state)
        # The general prior on lenses is not information from the captures.
        apart = replace(apart, cost=apart.cost - float(np.sum(of_any_rig.misfit(apart.state.additive())[0][:SHARED])))
    return Refinement(
        problem,
        noise,
        best,
        _of_all_columns(covariance, best.state),
        tuple(alternatives),
        valley,
        tension,
        sameness,
        apart,
        scale,
    )


def _problem(captures: Sequence[Cells], prior: Prior, noise: Sequence[Noise]) -> CornerProblem:
    """Of captures with the noise of each."""
    variances = [level.variances(cells) for cells, level in zip(captures, noise, strict=True)]
    return CornerProblem.of(captures, prior, variances)


def _traced(problem: CornerProblem, best: CornerFit) -> tuple[CornerFit, Valley]:
    """Return the lowest fit of a valley, and the valley traced from there.

    A minimisation stops early where the valley is nearly flat; tracing it further finds where it descends again.
    """
    for _ in range(_TRACES):
        valley = trace_valley(problem, best)
        lower = minimise(problem, valley.lowest) if valley.gain > _GAINED else best
        if not lower.cost < best.cost - _GAINED:
            break
        best = lower
    return best, valley


def _with_any_angles(minimum: WeighedFit) -> CornerProblem:
    """Return the problem of a minimum with the angles of its corners all but free."""
    state = minimum.fit.state
    angles = np.arange(SHARED, SHARED + state.off_square.size)
    return minimum.problem.under(minimum.problem.prior.with_sigmas(angles, np.radians(_ANY_ANGLE_DEG)))


def _best_first(minima: Sequence[WeighedFit]) -> list[WeighedFit]:
    """Return different minima, that with the most evidence first."""
    ordered = sorted((minimum for minimum in minima if np.isfinite(minimum.cost)), key=attrgetter("cost"))
    return [ordered[k] for k in _different([minimum.fit.state for minimum in ordered])]


def _squared(state: State) -> State:
    """Return the state with exactly square corners."""
    return replace(state, off_square=np.zeros_like(state.off_square))


def _of_all_columns(covariance: Floats, state: State) -> Floats:
    """Fill in the covariance (size, size) of tied columns from the columns they are tied to."""
    followed = state.followed
    every: Floats = covariance[np.ix_(followed, followed)]
    return every


def _with_planes(
    captures: Sequence[Cells], best: CornerFit, knowledge: Knowledge, noise: Sequence[Noise], further: Further
) -> tuple[CornerFit, CornerProblem]:
    """Return fit and problem with the further planes that pass the tests of squareness and flatness."""
    variances = [level.variances(of_capture) for of_capture, level in zip(captures, noise, strict=True)]
    of_faces = mean_square(np.concatenate(best.residuals), np.concatenate(variances))
    cells, state = further(captures, best.state)
    while True:
        minimum = weigh(_problem(cells, knowledge.prior(state), noise), state)
        fit, problem = minimum.fit, minimum.problem
        refuted = oblique_planes(fit.state) or unexplained(problem, fit, of_faces)
        if not refuted:
            return fit, problem
        cells, state = without(cells, fit.state, refuted)


def explore(captures: Sequence[Cells], starts: list[CornerFit], knowledge: Knowledge) -> list[CornerFit]:
    """Refine the starts (best first); return the distinct minima worth considering, best first."""
    problem = CornerProblem.of(captures, knowledge.prior(starts[0].state), _levels(starts[0]))
    best = minimise(problem, starts[0].state)
    ceiling = HOPELESS * best.cost
    fits = _distinct([best, *(minimise(problem, fit.state, ceiling=ceiling) for fit in starts[1:])])
    return [fit for fit in fits if fit.cost <= HOPELESS * fits[0].cost]


def _measured(captures: Sequence[Cells], fit: CornerFit, prior: Prior) -> tuple[Noise, ...]:
    """Estimate the noise of each capture with a prior that leaves the angles free: a violated assumption on them must
    not count as noise.

    `fit`: to some or all of the cells.
    """
    levels = [float(variance[0]) for variance in _levels(fit)]
    variances = [np.full(len(cells), level) for cells, level in zip(captures, levels, strict=True)]
    noise: tuple[Noise, ...] = ()
    for _ in range(_NOISE_ROUNDS):
        fit = minimise(CornerProblem.of(captures, prior, variances), fit.state, tolerance=_ROUGH)
        repeats = _repeats(fit.state, len(captures))
        absorbed = np.count_nonzero(prior.free) / sum(1 / times for times in repeats)
        measured = (noise_of(*pair, absorbed) for pair in zip(captures, fit.residuals, strict=True))
        noise = tuple(replace(level, repeats=times) for level, times in zip(measured, repeats, strict=True))
        variances = [level.variances(cells) for cells, level in zip(captures, noise, strict=True)]
    return noise


def _repeats(state: State, count: int) -> tuple[int, ...]:
    """Count, for each capture, the captures taken from the same place; 1 for photos, which share one pose."""
    if state.one_camera:
        return (1,) * count
    return tuple(sum(state.same_place(i, j) for j in range(count)) for i in range(count))


def _levels(fit: CornerFit) -> list[Floats]:
    """Return for each capture the variance of its residuals, the same for all cells (M,)."""
    return [np.full(len(residual), max(float(np.mean(residual**2)), 1e-12)) for residual in fit.residuals]


def _distinct(fits: list[CornerFit]) -> list[CornerFit]:
    """Different solutions, best first."""
    ordered = sorted((fit for fit in fits if np.isfinite(fit.cost)), key=attrgetter("cost"))
    return [ordered[k] for k in _different([fit.state for fit in ordered])]


def _different(states: Sequence[State]) -> list[int]:
    """Indices of states that are unlike all before."""

    def alike(k: int) -> Bools:
        return np.array([intrinsic_distance(state, states[k]).max() <= _SAME_SOLUTION for state in states])

    return list(distinct(len(states), alike))
