"""From where a registration has a room to near the minimum, when neither noise nor wrong ties are known yet."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.estimation import WRONG_ASSOCIATION, Fit, Problem, association_scores, rough_levels, separate_plane
from calib.finding import FindingKind
from calib.numerics import Bools, Floats
from calib.refusal import RefusalError
from calib.rooms.factors import Patch
from calib.rooms.priors import RoomPrior
from calib.rooms.room import Room

_ROUNDS = 10
_SETTLED = 0.5  # share of an approximate level, after a round that hardly lowered it
_LEAST_IN_FRONT = 0.98
_MOST_WRONG = 0.25  # share of the patches

RoomProblem = Problem[Room, Patch]

BEHIND_A_DEVICE = FindingKind(
    "behind-a-device",
    "With the poses of the registration, planes that were seen are behind a device.",
    "Register the stations again; those that do not fit have to be left out.",
)


def fit_roughly(patches: Sequence[Patch], room: Room, prior: RoomPrior) -> tuple[RoomProblem, Fit[Room]]:
    """From far off, at noise levels that follow the residuals down; without patches that end behind a device."""

    kept = patches
    for _ in range(_ROUNDS):
        patches = kept
        levels = _levels(patches, room, prior)
        variances = [np.full(len(patch.cells), level) for patch, level in zip(patches, levels, strict=True)]
        problem = RoomProblem(patches, variances, prior, prior.free(seen(room, patches)))
        fit = problem.minimise(room)
        room, kept = fit.state, in_front(fit.state, patches)
        if len(kept) == len(patches) and np.mean(_levels(kept, room, prior)) > _SETTLED * np.mean(levels):
            break
    return problem, fit


def _levels(patches: Sequence[Patch], room: Room, prior: RoomPrior) -> Floats:
    """Variances that the residuals show, (patches,)."""
    alike = RoomProblem(patches, [np.ones(len(patch.cells)) for patch in patches], prior, np.ones(room.size, np.bool_))
    return rough_levels(patches, alike.evaluate(room).residuals)


def without_wrong_ties(
    problem: RoomProblem, fit: Fit[Room], prior: RoomPrior
) -> tuple[RoomProblem, Fit[Room], RoomPrior]:
    """The fit with separate planes for patches that are not on their assigned plane, and the prior with these."""
    for _ in range(int(_MOST_WRONG * len(problem.parts))):
        scores, freedom = association_scores(problem, fit)
        per_freedom = scores / np.maximum(freedom, 1)
        tied = freedom > 0
        worst = int(np.argmax(per_freedom))
        if not tied.any() or per_freedom[worst] < WRONG_ASSOCIATION * max(float(np.median(per_freedom[tied])), 1.0):
            break
        start, _ = separate_plane(prior.start, problem.parts, worst)
        room, patches = separate_plane(fit.state, problem.parts, worst)
        prior = replace(prior, start=start)
        problem, fit = fit_roughly(patches, room, prior)
    return problem, fit, prior


def seen(room: Room, patches: Sequence[Patch]) -> Bools:
    """Which planes have a patch, (planes,)."""
    return np.isin(np.arange(len(room.planes)), [patch.plane for patch in patches])


def in_front(room: Room, patches: Sequence[Patch]) -> tuple[Patch, ...]:
    """The patches in front of both devices. Raises RefusalError if these are fewer than half."""
    chosen = tuple(patch for patch in patches if np.mean((patch.predict(room)[2] > 0).all(axis=1)) >= _LEAST_IN_FRONT)
    if len(chosen) < len(patches) / 2 or not chosen:
        raise RefusalError(
            BEHIND_A_DEVICE,
            f"With the poses of the registration, {len(patches) - len(chosen)} of {len(patches)} observed planes are "
            "behind the camera or the projector.",
            BEHIND_A_DEVICE.remedy,
        )
    return chosen
