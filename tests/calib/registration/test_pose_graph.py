"""Poses of several surfaces from those of pairs."""

import numpy as np
import pytest

from calib.geometry import Pose
from calib.numerics import Floats
from calib.registration import PairPose, solve_pose_graph

ALL = ((0, 1), (1, 2), (2, 3), (0, 3), (0, 2), (1, 3))


def the_places(rng: np.random.Generator) -> list[Pose]:
    poses = [Pose.exp(np.append(rng.normal(0, 0.7, 3), rng.normal(0, 3.0, 3))) for _ in range(4)]
    return [poses[0].inverse() @ pose for pose in poses]


def the_pairs(places: list[Pose], rng: np.random.Generator, edges: tuple[tuple[int, int], ...] = ALL) -> list[PairPose]:
    """Pairs with errors as their covariances say."""
    made = []
    for i, j in edges:
        true, centre = places[i].inverse() @ places[j], rng.normal(0, 2.0, 3)
        root = 1e-3 * rng.normal(size=(6, 6)) + np.diag([1e-3] * 3 + [2e-3] * 3)
        step = root @ rng.standard_normal(6)
        turn = Pose.exp(np.append(step[:3], np.zeros(3))).rotation
        off = Pose(turn, centre - turn @ centre + step[3:])
        made.append(PairPose(i, j, off @ true, centre, root @ root.T))
    return made


def errors(places: dict[int, Pose], truth: list[Pose]) -> Floats:
    return np.concatenate([(places[k] @ truth[k].inverse()).log() for k in places if k])


def test_errors_are_as_large_as_their_covariance_says() -> None:
    squares, chi2 = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = the_places(rng)
        graph = solve_pose_graph(the_pairs(truth, rng), 0)
        assert next(iter(graph.places)) == 0
        order = [k for k in graph.places if k]
        off = np.concatenate([(graph.places[k] @ truth[k].inverse()).log() for k in order])
        squares.append(off @ np.linalg.solve(graph.covariance[6:, 6:], off) / 18)
        chi2.append(graph.chi2 / graph.freedom)
        assert graph.freedom == 18
        assert not graph.dropped
    assert 0.75 < np.mean(squares) < 1.25
    assert 0.8 < np.mean(chi2) < 1.2


def test_a_wrong_pair_is_dropped() -> None:
    rng = np.random.default_rng(1)
    truth = the_places(rng)
    pairs = the_pairs(truth, rng)
    wrong = PairPose(
        0, 2, Pose.exp(np.array([0, 0, 0.1, 0.2, 0, 0])) @ pairs[4].pose, pairs[4].centre, pairs[4].covariance
    )
    pairs[4] = wrong
    graph = solve_pose_graph(pairs, 0)
    assert graph.dropped == (wrong,)
    assert not graph.contradict
    assert np.abs(errors(dict(graph.places), truth)).max() < 0.03


def test_a_contradiction_that_nothing_resolves_is_told() -> None:
    rng = np.random.default_rng(2)
    truth = the_places(rng)
    pairs = the_pairs(truth, rng, ((0, 1), (1, 2), (0, 2)))
    pairs[2] = PairPose(
        0, 2, Pose.exp(np.array([0, 0, 0.1, 0.2, 0, 0])) @ pairs[2].pose, pairs[2].centre, pairs[2].covariance
    )
    graph = solve_pose_graph(pairs, 0)
    assert graph.contradict
    assert graph.freedom == 6


def test_what_no_pair_connects_has_no_place() -> None:
    rng = np.random.default_rng(3)
    truth = the_places(rng)
    graph = solve_pose_graph(the_pairs(truth, rng, ((0, 1), (2, 3))), 0)
    assert set(graph.places) == {0, 1}
    assert graph.freedom == 0
    turn, shift = graph.sigmas(1, np.zeros(3))
    assert 1e-4 < turn < 0.01
    assert 1e-4 < shift < 0.05
    assert graph.sigmas(0, np.ones(3)) == pytest.approx((0.0, 0.0))
