"""Whether the planes of several stations are one plane."""

import numpy as np
import pytest
from scipy.special import chdtri

from calib.estimation import Fit, association_scores, minimise, plane_scores
from calib.numerics import Bools, Floats
from calib.rooms import Room
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


@pytest.fixture(scope="module")
def free(case: Case, prior: RoomPrior) -> Bools:
    return prior.free(np.ones(len(case.truth.planes), np.bool_))


def fitted(case: Case, prior: RoomPrior, variances: list[Floats], free: Bools) -> Fit[Room]:
    return minimise(case.found.patches, case.found.room, prior, variances, free)


def test_plane_scores_are_chi_square_distributed(case: Case, prior: RoomPrior, flat: list[Floats], free: Bools) -> None:
    fit, patches = fitted(case, prior, flat, free), case.found.patches
    scores, freedom = plane_scores(patches, fit, flat, free, flat)
    assert chdtri(freedom.sum(), 1 - 1e-4) < scores.sum() < chdtri(freedom.sum(), 1e-4)
    count = np.bincount([patch.plane for patch in patches], minlength=len(scores))
    assert np.all(freedom[count == 1] == 0)
    assert np.all(freedom[count > 1] <= 3 * (count[count > 1] - 1))
    of_patches, own_freedom = association_scores(patches, fit, flat, free)
    planes = np.array([patch.plane for patch in patches])
    same = (count[planes] == 2) & (freedom[planes] == 3) & (own_freedom == 3)
    assert np.count_nonzero(same) > 1
    assert of_patches[same] == pytest.approx(scores[planes[same]], rel=0.05)


def test_a_down_weighted_plane_is_tested_with_full_weight(
    case: Case, prior: RoomPrior, flat: list[Floats], free: Bools
) -> None:
    """Otherwise a plane that was once judged bent would stay so."""
    patches = case.found.patches
    stations = np.array([len(each) for each in case.found.stations_of])
    plane = int(np.argmax(stations == 2))
    loud = [LOUD * each if patch.plane == plane else each for patch, each in zip(patches, flat, strict=True)]
    expected, freedom = plane_scores(patches, fitted(case, prior, flat, free), flat, free, flat)
    found, alike = plane_scores(patches, fitted(case, prior, loud, free), loud, free, flat)
    assert found[plane] == pytest.approx(expected[plane], rel=0.05)
    assert alike[plane] == freedom[plane] > 0
