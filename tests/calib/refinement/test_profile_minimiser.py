"""Descent to the nearest minimum along the focal length, with all other parameters relaxed."""

import numpy as np
import pytest

from calib.numerics import covariance_of
from calib.refinement.focal_sweep import at_focal
from calib.refinement.parameters import CAMERA, PROJECTOR
from calib.refinement.profile_minimiser import minimise, relax
from tests.calib.refinement.conftest import Case


@pytest.mark.parametrize("factor", [0.8, 0.97, 1.25])
def test_the_minimum_is_found_from_a_distant_start(case: Case, factor: float) -> None:
    start = at_focal(case.truth, factor * case.truth.camera[0])
    found = minimise(case.problem, start)
    assert found.cost == pytest.approx(case.best.cost, abs=0.01)
    sigma = np.sqrt(covariance_of(found.information, case.prior.free).diagonal())
    for column, device, true in (
        (CAMERA.start, found.state.camera, case.truth.camera),
        (PROJECTOR.start, found.state.projector, case.truth.projector),
    ):
        assert 1e-4 < sigma[column] < 0.03
        assert abs(np.log(device[0] / true[0])) < 4 * sigma[column]


def test_two_residuals_of_each_cell_cost_two(case: Case) -> None:
    degrees = 2 * len(case.cells) - np.count_nonzero(case.prior.free)
    assert abs(case.best.cost - degrees) < 4 * np.sqrt(2 * degrees)


def test_a_ceiling_stops_only_hopeless_starts(case: Case) -> None:
    start = at_focal(case.truth, 1.05 * case.truth.camera[0])
    lowest = case.best.cost
    relaxed = relax(case.problem.holding(CAMERA.start), start)
    assert relaxed.cost > 1.05 * lowest
    through = minimise(case.problem, start, ceiling=1.04 * lowest)
    assert through.cost == pytest.approx(lowest, abs=0.01)
    stopped = minimise(case.problem, start, ceiling=0.5 * lowest)
    assert stopped.cost == pytest.approx(relaxed.cost)


def test_a_fixed_parameter_stays_and_the_others_reach_their_minimum(case: Case) -> None:
    start = at_focal(case.truth, 1.02 * case.truth.camera[0])
    anchored = case.problem.holding(CAMERA.start)
    fit = relax(anchored, start, tolerance=1e-6)
    assert fit.state.camera[0] == start.camera[0]
    slope = fit.gradient[anchored.free]
    size = np.sqrt(fit.information.diagonal()[anchored.free])
    assert np.abs(slope / size).max() < 0.01
    assert fit.gradient[CAMERA.start] > 10 * np.abs(slope).max() / size.max()


def test_fewer_steps_end_farther_from_the_minimum(case: Case) -> None:
    start = at_focal(case.truth, 1.3 * case.truth.camera[0])
    costs = [relax(case.problem, start, steps=steps).cost for steps in (0, 1, 3, 40)]
    assert costs[0] > costs[1] > costs[2] > costs[3]
