"""Whether the planes of several stations are one plane."""

import numpy as np
import pytest
from scipy.special import chdtri

from calib.estimation import Problem, add_up, association_scores, plane_scores
from calib.numerics import Floats
from calib.refinement import ORDINARY_LENSES, ROTATION, SHARED, Knowledge, KnownRig
from calib.rooms import Patch, RigPrior, Room
from calib.rooms.factors import patches_of
from calib.rooms.priors import RoomPrior
from tests.calib.rooms.conftest import Case
from tests.support.states import gradient_of

REACH = 7.0
LOUD = 25.0


def prior_of(case: Case, rig: RigPrior | None = None) -> RoomPrior:
    rig = rig or RigPrior.from_calibration(case.truth.rig, np.diag(np.geomspace(1e-6, 1e-2, SHARED)))
    return RoomPrior.of(rig, [(0, 1), (2, 1), (1, 0)], 0.3, case.truth, (1.0, REACH))


def test_the_gradient_matches_the_cost(case: Case) -> None:
    prior, patches = prior_of(case), patches_of(case.cells, case.plane_of)
    variances = [np.full(len(patch.cells), 1e4) for patch in patches]  # no cell is beyond Huber's threshold
    room = case.start
    some = [*range(SHARED), *range(SHARED + 6, room.size, 5)]
    problem = Problem(patches, variances, prior, np.ones(room.size, np.bool_))
    fit = problem.evaluate(room)
    exact, scale = fit.gradient[some], np.sqrt(np.diag(fit.information))[some]
    numeric = gradient_of(lambda each: np.array(problem.evaluate(each).cost), room, some) / 2
    assert np.max(np.abs(exact - numeric) / scale) < 1e-3 * np.max(np.abs(exact) / scale)


def test_a_prior_costs_nothing_at_its_mean_and_one_at_a_sigma(case: Case) -> None:
    least = KnownRig(case.truth.rig, np.zeros((SHARED, SHARED))).safe_covariance
    sigma = 30 * np.sqrt(np.diag(least))
    prior = RigPrior.from_calibration(case.truth.rig, np.diag(sigma**2))
    assert prior.misfit(case.truth.rig).cost == pytest.approx(0.0, abs=1e-12)
    for column in range(SHARED):
        off = case.truth.rig.moved(sigma * (np.arange(SHARED) == column))
        assert prior.misfit(off).cost == pytest.approx(1.0, rel=0.01)


def test_the_prior_of_a_rig_follows_from_the_corners_knowledge(case: Case) -> None:
    knowledge = case.knowledge
    prior = RigPrior.from_knowledge(knowledge, case.start.rig)
    assert not prior.known.any()
    sigma = 1 / np.sqrt(np.diag(prior.precision)[1:8])
    assert sigma == pytest.approx([knowledge.principal_point_sigma_px] * 2 + [*ORDINARY_LENSES[0].sigma])
    assert prior.precision[0, 0] == pytest.approx(0.7**-2)
    assert np.diag(prior.precision)[ROTATION.start : SHARED] == pytest.approx(0.0)
    assert prior.mean.camera[1:3] == pytest.approx(knowledge.principal_point_px)


def test_exactly_known_parameters_are_fixed(case: Case) -> None:
    size = case.made.calibration.camera.size
    exact = Knowledge(size, case.made.calibration.projector.size, (600.0, 500.0), 0.0, 0.3)
    prior = RigPrior.from_knowledge(exact, case.start.rig)
    assert np.flatnonzero(prior.known).tolist() == [1, 2]
    assert RigPrior.exactly(case.truth.rig).known.all()
    free = prior_of(case, prior).free(np.ones(len(case.truth.planes), np.bool_))
    assert not free[[1, 2]].any()
    assert not free[case.truth.place_columns(0)].any()
    assert free.sum() == case.truth.size - 2 - 6


def test_a_patch_behind_the_camera_costs_but_has_no_gradient(case: Case) -> None:
    prior, patches = prior_of(case), patches_of(case.cells, case.plane_of)[:1]
    variances = [np.full(len(patches[0].cells), 1.0)]
    columns = case.truth.plane_columns(patches[0].plane)
    step = np.zeros(case.truth.size)
    step[columns.stop - 1] = 10 * REACH  # the plane is brought behind the camera
    there: Room = case.truth.moved(step)
    fit = Problem(patches, variances, prior, np.ones(there.size, np.bool_)).evaluate(there)
    of_prior = add_up(there.size, prior.terms(there))
    assert fit.cost - of_prior.cost == pytest.approx(100.0 * len(patches[0].cells))
    assert fit.gradient == pytest.approx(of_prior.gradient)


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
