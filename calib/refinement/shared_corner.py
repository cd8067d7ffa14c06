"""Tie the angles of several captures of one corner, whatever order their faces were found in.

Each capture's faces are numbered clockwise around the vertex, so only the first face is ambiguous between captures. It
is found from the angles. The increase in cost tests whether the captures share their angles at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from operator import attrgetter

import numpy as np
import scipy

from calib.estimation import Cells
from calib.finding import FindingKind
from calib.geometry import FACES, leg_signs
from calib.numerics import Floats, covariance_of
from calib.refinement.likelihood import CornerFit, CornerProblem, Knowledge
from calib.refinement.parameters import PER_CORNER, SHARED, State
from calib.refinement.profile_minimiser import minimise
from calib.refusal import RefusalError

_MOST_CAPTURES = 8
_CLOSER_LOOKS = 9
_SIGNIFICANT = 0.999
_CLOSE = 12.0  # in cost of a sample of the cells; orders above the best by more are dropped

TOO_MANY_CAPTURES = FindingKind(
    "too-many-captures",
    "More captures of one corner were given than can be put in order.",
    "Calibrate from fewer of them, or set corner.same: false.",
    ("most_captures",),
)


@dataclass(frozen=True)
class Sameness:
    """Whether captures show one corner.

    `same`: the verdict. `shifts`: for each capture, its face s has the number (s + shift) mod 3 in the common order.
    `cost`: increase of the cost when the angles are shared; `limit`: the largest acceptable increase. `lead`: extra
    cost of the next best order of the faces; small if the corner is too square to decide. `spread` (SHARED, SHARED):
    covariance that the solutions for the other orders add to the shared parameters.
    """

    same: bool
    shifts: tuple[int, ...]
    cost: float
    limit: float
    lead: float
    spread: Floats


def tie(
    captures: Sequence[Cells], thinned: Sequence[Cells], fits: list[CornerFit], knowledge: Knowledge
) -> tuple[Sequence[Cells], list[CornerFit], Sameness | None]:
    """Return consistently labelled captures, fits with one shared corner (best first), and the test of sharing.

    `fits`: of the thinned captures, each with a corner of its own, best first. If sharing is refuted, captures and fits
    are returned unchanged. With exactly square corners there is nothing to share and nothing to test.
    """
    if knowledge.squareness_deg == 0:
        return captures, fits, None
    if len(captures) > _MOST_CAPTURES:
        raise RefusalError(
            TOO_MANY_CAPTURES,
            f"{len(captures)} captures of one corner were given; at most {_MOST_CAPTURES} can be put in order.",
            TOO_MANY_CAPTURES.remedy,
            {"most_captures": float(_MOST_CAPTURES)},
        )
    levels = [max(float(np.mean(r**2)), 1e-12) for r in fits[0].residuals]
    trials = [
        _in_order(thinned, _shared(fit.state, shifts), shifts, knowledge, levels)
        for fit in fits
        for shifts in _promising(fit, knowledge)
    ]
    trials.sort(key=attrgetter("fit.cost"))
    problem = CornerProblem.of(thinned, knowledge.prior(fits[0].state), _variances(thinned, levels))
    apart = minimise(problem, fits[0].state)
    raised = trials[0].fit.cost - apart.cost
    limit = float(scipy.special.chdtri(PER_CORNER * (len(captures) - 1), 1 - _SIGNIFICANT))
    if not np.isfinite(raised):  # no order fits at all, as of captures that no rig explains
        return captures, fits, Sameness(False, trials[0].shifts, np.inf, limit, np.inf, np.zeros((SHARED, SHARED)))
    # All cells may distinguish orders that a sample of them does not.
    close = [trial for trial in trials if trial.fit.cost < trials[0].fit.cost + _CLOSE]
    whole = sorted(
        (_in_order(captures, trial.fit.state, trial.shifts, knowledge, levels) for trial in close),
        key=attrgetter("fit.cost"),
    )
    shifts = whole[0].shifts
    lead = min(
        [trial.fit.cost - whole[0].fit.cost for trial in whole if trial.shifts != shifts]
        + [trial.fit.cost - trials[0].fit.cost for trial in trials if trial not in close],
        default=np.inf,
    )
    sameness = Sameness(raised < limit, shifts, raised, limit, lead, _spread(whole))
    if not sameness.same:
        return captures, fits, sameness
    in_order = [relabel(cells, shift) for cells, shift in zip(captures, shifts, strict=True)]
    first = [trial.fit for trial in whole if trial.shifts == shifts]
    return in_order, [*first, *(t.fit for t in trials if t.shifts == shifts and t not in close)], sameness


@dataclass(frozen=True, eq=False)
class _Trial:
    """The fit of captures whose face numbers are shifted cyclically by `shifts`."""

    fit: CornerFit
    shifts: tuple[int, ...]


def _in_order(
    captures: Sequence[Cells], start: State, shifts: tuple[int, ...], knowledge: Knowledge, levels: Sequence[float]
) -> _Trial:
    relabelled = [relabel(cells, shift) for cells, shift in zip(captures, shifts, strict=True)]
    problem = CornerProblem.of(relabelled, knowledge.prior(start), _variances(captures, levels))
    return _Trial(minimise(problem, start), shifts)


def _variances(captures: Sequence[Cells], levels: Sequence[float]) -> list[Floats]:
    return [np.full(len(cells), level) for cells, level in zip(captures, levels, strict=True)]


def _spread(trials: Sequence[_Trial]) -> Floats:
    """Σ wᵢ dᵢ dᵢᵀ with dᵢ from the first to the best fit of each order, and wᵢ its probability, (SHARED, SHARED)."""
    best = {trial.shifts: trial.fit for trial in reversed(trials)}
    first = trials[0].fit
    weights = np.exp([(first.cost - fit.cost) / 2 for fit in best.values()])
    apart = np.stack([first.state.step_to(fit.state)[:SHARED] for fit in best.values()])
    spread: Floats = (apart * (weights / weights.sum())[:, None]).T @ apart
    return spread


def relabel(cells: Cells, shift: int) -> Cells:
    """Return the cells with face numbers shifted cyclically by `shift`."""
    return replace(cells, plane=np.where(cells.plane < len(FACES), (cells.plane + shift) % 3, cells.plane))


def is_anticlockwise(cells: Cells, vertex: Floats) -> bool:
    """Return whether faces 0, 1, 2 run anticlockwise around the `vertex` (3,) in the camera's image."""
    around = [cells.camera_px[cells.plane == face].mean(axis=0) * vertex[2] - vertex[:2] for face in FACES]
    angles = np.array([np.arctan2(y, x) for x, y in around])
    # y points down, so angles grow clockwise.
    return bool((angles[1] - angles[0]) % (2 * np.pi) > (angles[2] - angles[0]) % (2 * np.pi))


def reflected(cells: Cells) -> Cells:
    """Return the cells with faces 1 and 2 exchanged."""
    return replace(cells, plane=np.where((cells.plane == 1) | (cells.plane == 2), 3 - cells.plane, cells.plane))


def oriented(captures: Sequence[Cells], fit: CornerFit) -> CornerFit:
    """Orient every leg along its faces: only then are angles comparable between captures."""
    state = fit.state
    flips = np.ones(state.size)
    off_square, corners = state.off_square.copy(), []
    for i, (cells, corner) in enumerate(zip(captures, state.corners, strict=True)):
        on_faces = cells.plane < len(FACES)
        points = state.points(cells.camera_px[on_faces], cells.plane[on_faces], i)
        signs = leg_signs(state.legs(i), corner.vertex, points)
        # Reversing a leg changes the sign of both angles between its face and the others.
        turned = np.prod(signs) * signs
        off_square[corner.shape] *= turned
        flips[state.angle_columns(corner.shape)] = turned
        corners.append(replace(corner, frame=corner.frame * signs[:, None]))
    state = replace(state, off_square=off_square, corners=tuple(corners))
    return replace(
        fit, state=state, gradient=fit.gradient * flips, information=fit.information * np.outer(flips, flips)
    )


def _promising(fit: CornerFit, knowledge: Knowledge) -> list[tuple[int, ...]]:
    """Return the at most `_CLOSER_LOOKS` orders of the faces that agree best with the angles of each capture alone.

    Tying the angles a costs dᵀ (D Σ Dᵀ)⁻¹ d, where d = D a are their differences and Σ is their covariance without the
    prior.
    """
    count = len(fit.state.corners)
    free = knowledge.prior(fit.state).free
    covariance = covariance_of(fit.information, free)
    angles = slice(fit.state.angle_columns(0).start, fit.state.angle_columns(count - 1).stop)
    covariance = covariance[angles, angles]
    orders = [(0, *later) for later in product(range(3), repeat=count - 1)]

    def cost(shifts: tuple[int, ...]) -> float:
        differences = _differences(shifts)
        apart = differences @ fit.state.off_square.ravel()
        return float(apart @ np.linalg.pinv(differences @ covariance @ differences.T, hermitian=True) @ apart)

    return sorted(orders, key=cost)[:_CLOSER_LOOKS]


def _differences(shifts: tuple[int, ...]) -> Floats:
    """D (3 (C − 1), 3 C): the angles of each capture but the first, in the first's order, minus those of the first."""
    differences = np.zeros((3 * (len(shifts) - 1), 3 * len(shifts)))
    for i, shift in enumerate(shifts[1:]):
        rows = slice(3 * i, 3 * i + 3)
        differences[rows, :3] = -np.eye(3)
        differences[rows, 3 * (i + 1) : 3 * (i + 2)] = np.roll(np.eye(3), shift, axis=0)
    return differences


def _shared(state: State, shifts: tuple[int, ...]) -> State:
    """Return the state with one corner for all captures, with the mean of their angles."""
    angles = [np.roll(off, shift) for off, shift in zip(state.off_square, shifts, strict=True)]
    corners = tuple(
        replace(corner, frame=np.roll(corner.frame, shift, axis=0), shape=0)
        for corner, shift in zip(state.corners, shifts, strict=True)
    )
    return replace(state, off_square=np.mean(angles, axis=0)[None], corners=corners)
