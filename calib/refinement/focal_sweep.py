"""The profile likelihood over the whole range of the camera's focal length, all other parameters optimised.

The profile can have several minima: a wrong solution with focals a quarter too long can fit almost as well. The
paper's transfer gives a starting state at each trial, so that finding a minimum does not depend on an initial guess.

For two photos by one camera the transfer of intrinsics through the corner has to be the identity. So the paper's
objective (its equation 13) becomes E(f, x_0, y_0) = |γ'| + |f_x' − f| + |f_y' − f| + |x_0' − x_0| + |y_0' − y_0| for
the transferred camera (f_x', f_y', γ', x_0', y_0'), and the principal point need not be known: at each trial E selects
it from a grid.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from operator import attrgetter
from typing import Protocol

import numpy as np

from calib.closed_form import Objective, Transfer, objective_for
from calib.estimation import Cells
from calib.geometry import Pose
from calib.numerics import Floats
from calib.refinement.distortion_from_planes import Straightened, straighten
from calib.refinement.likelihood import CornerFit, CornerProblem, Knowledge
from calib.refinement.parameters import CAMERA, PROJECTOR, PlacedCorner, State, without_lens
from calib.refinement.profile_minimiser import relax

SWEEP_CELLS = 200
HOPELESS = 4.0  # minima with this many times the lowest cost are not refined
_SIGMA_PX = 0.05  # typical residual error of a decoder; replaced by the measured value afterwards
_TOLERANCE, _STEPS = 1.0, 10


class Starts(Protocol):
    """Provides the starting states of the sweep."""

    def starts(self, focal_px: Floats) -> list[list[State]]:
        """Return starting states for each focal (n,)."""


@dataclass(frozen=True)
class Family:
    """The paper's one-dimensional family of solutions for one capture, from `straightened` matches."""

    objective: Objective
    straightened: Straightened

    def starts(self, focal_px: Floats) -> list[list[State]]:
        """Return for each camera focal (n,) the at most two solutions with all matches in front of both devices."""
        transfers, in_front = self.objective.forward(focal_px, nearest=True)
        usable = in_front & np.isfinite(transfers.matrix).all(axis=(1, 2))
        count = len(focal_px)
        return [
            [self._state(transfers, i, float(focal)) for i in (trial, count + trial) if usable[i]]
            for trial, focal in enumerate(focal_px)
        ]

    def _state(self, transfers: Transfer, i: int, focal: float) -> State:
        """Solution number i as a state: exactly square, with one radial term for each lens."""
        baseline = np.linalg.norm(transfers.translation[i])
        matrix = transfers.matrix[i]
        projector_focal = np.sqrt(matrix[0, 0] * matrix[1, 1])
        bends = self.straightened.camera_bend * focal**2, self.straightened.projector_bend * projector_focal**2
        return State(
            without_lens(focal, np.array(self.objective.principal_point_px), bends[0]),
            without_lens(projector_focal, matrix[:2, 2], bends[1]),
            Pose(transfers.rotation[i], transfers.translation[i] / baseline),
            np.zeros((1, 3)),
            (PlacedCorner(transfers.normals[i], transfers.vertex[i] / baseline),),
        )


def family_of(cells: Cells, knowledge: Knowledge) -> Family:
    """Prepare the family for one capture. Raises TooFewMatchesError if a face has fewer than four cells."""
    camera, projector = knowledge.lenses
    straightened = straighten(
        cells, knowledge.principal_point_px, knowledge.projector_centre_px, (camera.bends, projector.bends)
    )
    return Family(objective_for(straightened.matches, knowledge.principal_point_px), straightened)


def sweep_one(cells: Cells, family: Starts, focal_px: Floats, knowledge: Knowledge) -> list[CornerFit | None]:
    """Return the best fit of one capture with the focal held at each trial (n,); None where there is none.

    Each trial has up to three starts: the paper's two solutions, which may lie on other branches, and the fit at the
    previous trial.
    """
    fits: list[CornerFit | None] = []
    last: State | None = None
    hopeless = np.inf
    for focal, starts in zip(focal_px, family.starts(focal_px), strict=True):
        fit = _best([cells], starts, last, float(focal), knowledge, hopeless)
        if fit:
            last, hopeless = fit.state, min(hopeless, HOPELESS * (fit.cost + len(cells)))
        fits.append(fit)
    return fits


def sweep_jointly(
    captures: Sequence[Cells], alone: Sequence[Sequence[CornerFit | None]], focal_px: Floats, knowledge: Knowledge
) -> list[CornerFit | None]:
    """Return the best joint fit at each trial (n,), given the fits of each capture alone; None where there is none.

    The sum of the separate costs is a lower bound of the joint cost, so trials whose separate fits are already
    hopeless are skipped.
    """
    fits: list[CornerFit | None] = [None] * len(focal_px)
    bounds = np.array([sum(fit.cost if fit else np.inf for fit in trial) for trial in zip(*alone, strict=True)])
    lowest, count = np.inf, sum(len(cells) for cells in captures)
    for trial in np.argsort(bounds):
        if not bounds[trial] < HOPELESS * (lowest + count):
            break
        states = [fit.state for fits_alone in alone if (fit := fits_alone[trial])]
        solved = [i for i, fit in enumerate(fits) if fit]
        nearest = fits[min(solved, key=lambda i: abs(i - trial))] if solved else None
        starts = _most_promising(captures, [_combined(shared, states) for shared in states], knowledge)
        fit = _best(captures, starts, nearest.state if nearest else None, float(focal_px[trial]), knowledge)
        fits[trial] = fit
        lowest = min(lowest, fit.cost if fit else np.inf)
    return fits


def twins(cells: Cells, family: Starts, fit: CornerFit, knowledge: Knowledge) -> list[CornerFit]:
    """Refit one capture at the focal of `fit`, starting from both of the paper's solutions there."""
    (starts,) = family.starts(np.array([fit.state.camera[0]]))
    starts = [knowledge.holding(state) for state in starts]
    anchored = _problem([cells], fit.state, knowledge).holding(CAMERA.start)
    return [relax(anchored, state) for state in starts]


def minima(sweep: Sequence[CornerFit | None]) -> list[CornerFit]:
    """Return the local minima of a sweep, ends included, best first, without the hopeless ones."""
    fits = [fit for fit in sweep if fit]
    costs = np.array([np.inf, *(fit.cost for fit in fits), np.inf])
    low = [fit for i, fit in enumerate(fits) if costs[i + 1] <= costs[i] and costs[i + 1] <= costs[i + 2]]
    low.sort(key=attrgetter("cost"))
    count = sum(len(residual) for residual in low[0].residuals) if low else 0
    return [fit for fit in low if fit.cost <= HOPELESS * (low[0].cost + count)]


def at_focal(state: State, focal: float) -> State:
    """Return the state with another camera focal, the projector's scaled in proportion."""
    step = np.zeros(state.size)
    step[CAMERA.start] = step[PROJECTOR.start] = np.log(focal / state.camera[0])
    return state.moved(step)


def _best(
    captures: Sequence[Cells],
    starts: list[State],
    last: State | None,
    focal: float,
    knowledge: Knowledge,
    hopeless: float = np.inf,
) -> CornerFit | None:
    """Return the best fit with the focal held, from the starts and from the fit at another trial.

    Fits whose cost exceeds `hopeless` are not converged fully.
    """
    tried = [knowledge.holding(state) for state in starts] + ([at_focal(last, focal)] if last else [])
    if not tried:
        return None
    anchored = _problem(captures, tried[0], knowledge).holding(CAMERA.start)
    best: CornerFit | None = None
    for state in reversed(tried):  # the fit at another trial is usually the best
        ceiling = min(best.cost, hopeless) if best else hopeless
        fit = relax(anchored, state, tolerance=_TOLERANCE, steps=_STEPS, ceiling=ceiling)
        if fit.cost < (best.cost if best else np.inf):
            best = fit
    return best


def _most_promising(captures: Sequence[Cells], starts: list[State], knowledge: Knowledge) -> list[State]:
    problem = _problem(captures, starts[0], knowledge)
    return sorted(starts, key=lambda state: problem.evaluate(state).cost)[:1]


def _problem(captures: Sequence[Cells], layout: State, knowledge: Knowledge) -> CornerProblem:
    """Of captures whose noise is not measured yet."""
    variances = [np.full(len(cells), _SIGMA_PX**2) for cells in captures]
    return CornerProblem.of(captures, knowledge.prior(layout), variances)


def _combined(shared: State, alone: Sequence[State]) -> State:
    """Combine all captures, each with its own corner, under the rig of one of them."""
    corners = tuple(replace(state.corners[0], shape=i) for i, state in enumerate(alone))
    return replace(shared, off_square=np.concatenate([state.off_square for state in alone]), corners=corners)


_GRID = (-0.2, -0.1, 0.0, 0.1, 0.2)  # principal points to try, in image widths off the expected one
_STARTS = 1  # principal points to start from, for each focal and each of the two corners


@dataclass(frozen=True)
class PhotoFamily:
    """Starts for one pair of photos, from `straightened` matches; `points_px` (P, 2): principal points to try."""

    objective: Objective
    straightened: Straightened
    points_px: Floats

    def starts(self, focal_px: Floats) -> list[list[State]]:
        """Return for each focal (n,) the states with the smallest difference between both photos' cameras."""
        count = len(focal_px)
        costs = np.full((len(self.points_px), 2 * count), np.inf)
        states: dict[tuple[int, int], State] = {}
        for p, point in enumerate(self.points_px):
            objective = replace(self.objective, principal_point_px=(float(point[0]), float(point[1])))
            transfers, in_front = objective.forward(focal_px, nearest=True)
            usable = in_front & np.isfinite(transfers.matrix).all(axis=(1, 2))
            focals = np.concatenate([focal_px, focal_px])
            costs[p] = np.where(usable, objective_of_photos(transfers.matrix, focals, point), np.inf)
            for i in np.flatnonzero(usable):
                camera = without_lens(focals[i], point, self._bend * focals[i] ** 2)
                baseline = np.linalg.norm(transfers.translation[i])
                states[p, int(i)] = State(
                    camera,
                    camera,
                    Pose(transfers.rotation[i], transfers.translation[i] / baseline),
                    np.zeros((1, 3)),
                    (PlacedCorner(transfers.normals[i], transfers.vertex[i] / baseline),),
                    one_camera=True,
                )
        nearest = np.argsort(costs, axis=0)[:_STARTS]
        return [
            [states[p, i] for i in (trial, count + trial) for p in map(int, nearest[:, i]) if (p, i) in states]
            for trial in range(count)
        ]

    @property
    def _bend(self) -> float:
        return (self.straightened.camera_bend + self.straightened.projector_bend) / 2


def objective_of_photos(matrices: Floats, focal_px: Floats, point_px: Floats) -> Floats:
    """E (n,) in pixels of transferred matrices (n, 3, 3) for trial focals (n,) and one principal point (2,)."""
    off: Floats = (
        np.abs(matrices[:, 0, 1]) + np.abs(matrices[:, 0, 0] - focal_px) + np.abs(matrices[:, 1, 1] - focal_px)
    )
    apart: Floats = np.sum(np.abs(matrices[:, :2, 2] - point_px), axis=1)
    return off + apart


def photo_family(cells: Cells, knowledge: Knowledge) -> PhotoFamily:
    """Prepare the family for one pair of photos. Raises TooFewMatchesError if a face has fewer than four cells."""
    centre = knowledge.principal_point_px
    straightened = straighten(cells, centre, centre, (knowledge.lenses[0].bends,) * 2)
    known = knowledge.principal_point_sigma_px == 0
    offsets = [(0.0, 0.0)] if known else list(product(_GRID, _GRID))
    points = np.array(centre) + knowledge.camera_size[0] * np.array(offsets)
    return PhotoFamily(objective_for(straightened.matches, centre), straightened, points)
