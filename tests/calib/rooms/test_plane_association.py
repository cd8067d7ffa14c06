"""Whether the planes of several stations are one plane."""

import numpy as np
import pytest
from scipy.special import chdtri

from calib.estimation import Problem, association_scores, plane_scores
from calib.numerics import Floats
from calib.rooms import Patch, Room
from calib.rooms.priors import RoomPrior
from tests.calib.rooms.conftest import Case
from tests.calib.rooms.test_priors import prior_of

LOUD = 25.0


@pytest.fixture(scope="module")
def prior(case: Case) -> RoomPrior:
    return prior_of(case)


@pytest.fixture(scope="module")
def flat(case: Case) -> list[Floats]:
    """Variances of cells with noise only."""
    return [
        case.found.levels.stations[patch.station].variances(patch.cells).astype(np.float64)
        for patch in case.found.patches
    ]


def problem_of(case: Case, prior: RoomPrior, variances: list[Floats]) -> Problem[Room, Patch]:
    return Problem(case.found.patches, variances, prior, prior.free(np.ones(len(case.truth.planes), np.bool_)))


def test_plane_scores_are_chi_square_distributed(case: Case, prior: RoomPrior, flat: list[Floats]) -> None:
    problem, patches = problem_of(case, prior, flat), case.found.patches
    fit = problem.minimise(case.found.room)
    scores, freedom = plane_scores(problem, fit, flat)
    assert chdtri(freedom.sum(), 1 - 1e-4) < scores.sum() < chdtri(freedom.sum(), 1e-4)
    count = np.bincount([patch.plane for patch in patches], minlength=len(scores))
    assert np.all(freedom[count == 1] == 0)
    assert np.all(freedom[count > 1] <= 3 * (count[count > 1] - 1))
    of_patches, own_freedom = association_scores(problem, fit)
    planes = np.array([patch.plane for patch in patches])
    same = (count[planes] == 2) & (freedom[planes] == 3) & (own_freedom == 3)
    assert np.count_nonzero(same) > 1
    assert of_patches[same] == pytest.approx(scores[planes[same]], rel=0.05)


def test_a_down_weighted_plane_is_tested_with_full_weight(case: Case, prior: RoomPrior, flat: list[Floats]) -> None:
    """Otherwise a plane that was once judged bent would stay so."""
    patches = case.found.patches
    stations = np.array([len(each) for each in case.found.stations_of])
    plane = int(np.argmax(stations == 2))
    loud = [LOUD * each if patch.plane == plane else each for patch, each in zip(patches, flat, strict=True)]
    problems = [problem_of(case, prior, variances) for variances in (flat, loud)]
    (expected, freedom), (found, alike) = (
        plane_scores(problem, problem.minimise(case.found.room), flat) for problem in problems
    )
    assert found[plane] == pytest.approx(expected[plane], rel=0.05)
    assert alike[plane] == freedom[plane] > 0
