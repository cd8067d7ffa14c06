"""The sweep along the focal length: starts from the paper's transfer; minima are separated, hopeless ones dropped."""

from dataclasses import replace

import numpy as np
import pytest

from calib.refinement.focal_sweep import at_focal, family_of, minima, sweep_jointly, sweep_one, twins
from calib.refinement.likelihood import CornerFit
from calib.refinement.parameters import State
from calib.synthetic import random_capture, random_captures
from tests.calib.refinement.conftest import KNOWLEDGE, Case
from tests.support.states import each_a_cell, true_state

FOCALS = np.geomspace(1200.0, 2600.0, 12)


def test_the_starts_at_the_true_focal_include_the_truth() -> None:
    capture = random_capture(np.random.default_rng(3), count=800, noise_px=0.0)
    truth = true_state(capture)
    family = family_of(each_a_cell(capture), KNOWLEDGE)
    starts = family.starts(np.array([truth.camera[0], 1.3 * truth.camera[0]]))
    assert [len(start) in (1, 2) for start in starts] == [True, True]
    best = min(starts[0], key=lambda state: abs(state.projector[0] - truth.projector[0]))
    np.testing.assert_allclose(best.camera[:3], truth.camera[:3], rtol=1e-6)
    np.testing.assert_allclose(best.projector[:3], truth.projector[:3], rtol=0.01)
    np.testing.assert_allclose(best.pose.rotation, truth.pose.rotation, atol=0.01)
    np.testing.assert_allclose(best.pose.translation, truth.pose.translation, atol=0.03)
    np.testing.assert_allclose(best.corners[0].vertex, truth.corners[0].vertex, rtol=0.03)


def test_both_focals_scale_together(case: Case) -> None:
    moved = at_focal(case.truth, 2000.0)
    assert moved.camera[0] == pytest.approx(2000.0)
    assert moved.projector[0] / case.truth.projector[0] == pytest.approx(2000.0 / case.truth.camera[0])
    assert replace(moved, camera=case.truth.camera, projector=case.truth.projector).corners == moved.corners


def test_the_sweep_is_lowest_at_the_truth(case: Case) -> None:
    truth = case.truth.camera[0]
    focals = truth * np.array([0.8, 0.9, 0.97, 1.0, 1.03, 1.1, 1.2])
    sweep = sweep_one(case.cells, family_of(case.cells, KNOWLEDGE), focals, KNOWLEDGE)
    fits = [fit for fit in sweep if fit]
    assert len(fits) == len(focals)
    np.testing.assert_allclose([fit.state.camera[0] for fit in fits], focals, rtol=1e-12)
    assert np.argmin([fit.cost for fit in fits]) == 3
    low = minima(sweep)
    assert low[0] is sweep[3]
    again = twins(case.cells, family_of(case.cells, KNOWLEDGE), low[0], KNOWLEDGE)
    assert 1 <= len(again) <= 2
    assert min(fit.cost for fit in again) == pytest.approx(low[0].cost, rel=0.05)
    np.testing.assert_allclose([fit.state.camera[0] for fit in again], truth, rtol=1e-12)


def test_captures_of_one_rig_fit_no_better_together_than_alone() -> None:
    captures = random_captures(np.random.default_rng(5), 2, count=600, noise_px=0.1, same=False)
    cells = [each_a_cell(capture) for capture in captures]
    truth = captures[0].calibration.camera.focal_px[0]
    focals = truth * np.array([0.4, 0.9, 1.0, 1.1, 3.0])
    alone = [sweep_one(cell, family_of(cell, KNOWLEDGE), focals, KNOWLEDGE) for cell in cells]
    sweep = sweep_jointly(cells, alone, focals, KNOWLEDGE)
    costs = [fit.cost if fit else np.inf for fit in sweep]
    assert np.argmin(costs) == 2
    bounds = [sum(fit.cost if fit else np.inf for fit in pair) for pair in zip(*alone, strict=True)]
    assert all(cost > 0.98 * bound for cost, bound in zip(costs, bounds, strict=True))
    lowest, count = costs[2], sum(map(len, cells))
    for fit, bound in zip(sweep, bounds, strict=True):
        assert fit is None or bound < 4 * (lowest + count)
        if fit:
            assert [corner.shape for corner in fit.state.corners] == [0, 1]
            assert fit.state.off_square.shape == (2, 3)


def fit_of(state: State, cost: float) -> CornerFit:
    return CornerFit(cost, np.zeros(0), np.zeros((0, 0)), state, (np.zeros((10, 2)),))


@pytest.mark.parametrize(
    ("costs", "kept"),
    [
        ([5.0, 3.0, 4.0, 1.0, 2.0], [1.0, 3.0]),
        ([1.0, 2.0, 3.0], [1.0]),
        ([3.0, 2.0, 1.0], [1.0]),
        ([3.0, None, 2.0, None, 4.0], [2.0]),
        ([1.0, 60.0, 44.0, 70.0], [1.0, 44.0]),  # four times the lowest and the ten cells
        ([1.0, 60.0, 44.1, 70.0], [1.0]),
        ([None, None], []),
    ],
)
def test_minima_are_those_lower_than_their_neighbours(case: Case, costs: list[float | None], kept: list[float]) -> None:
    sweep = [None if cost is None else fit_of(case.truth, cost) for cost in costs]
    assert [fit.cost for fit in minima(sweep)] == kept
