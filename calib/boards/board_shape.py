"""The board itself: its orientation in each view, and whether its bend varies between poses.

A chessboard with odd numbers of corners is symmetric under half a turn, one with as many rows as columns under a
quarter. A bend, or an irregular print, is not.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.boards.likelihood import BoardVariances, BoardView, Prior, board_problem
from calib.boards.parameters import PlacedBoard, State, flex_columns
from calib.geometry import Pose
from calib.numerics import Floats

_CLEARLY = 2.0  # in cost
_PASSES = 2
_ROUGH = 0.03  # tolerance in cost
_FLEXES = (3e-4, 1e-3, 3e-3)  # of half the board's length
_EVIDENT = 3.0  # nats


def oriented_consistently(
    views: Sequence[BoardView], state: State, prior: Prior, levels: BoardVariances, turns: int
) -> tuple[tuple[BoardView, ...], State]:
    """Views and state with each board oriented like the first one, among this many symmetric orientations."""
    views, current = list(views), board_problem(views, prior, levels).minimise(state, tolerance=_ROUGH)
    for _ in range(_PASSES if turns > 1 else 0):
        changed = False
        for i in range(1, len(views)):
            for turn in range(1, turns):
                trial_views, trial = _turned(views, current.state, i, turn / turns)
                fit = board_problem(trial_views, prior, levels).minimise(trial, tolerance=_ROUGH)
                if fit.cost < current.cost - _CLEARLY:
                    views, current, changed = trial_views, fit, True
        if not changed:
            break
    return tuple(views), current.state


def _turned(views: list[BoardView], state: State, which: int, turn: float) -> tuple[list[BoardView], State]:
    """The views with one board rotated about its normal."""
    angle = 2 * np.pi * turn
    about = np.round(np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]))
    board = state.boards[which]
    boards = [*state.boards]
    boards[which] = PlacedBoard(Pose(board.pose.rotation @ about.T, board.pose.translation), board.flex)
    turned = [*views]
    turned[which] = replace(views[which], points=views[which].points @ about[:2, :2].T)
    return turned, replace(state, boards=tuple(boards))


def flex_of(views: Sequence[BoardView], state: State, prior: Prior, levels: BoardVariances) -> float:
    """By how much the board's bend differs from pose to pose, as a `Prior` has it; 0 where a rigid one does as well.

    The evidence is Laplace's approximation of it: cost and curvature at the maximum.
    """
    evidence = [_log_evidence(views, state, replace(prior, flex=flex), levels) for flex in (0.0, *_FLEXES)]
    best = int(np.argmax(evidence))
    return _FLEXES[best - 1] if best and evidence[best] > evidence[0] + _EVIDENT else 0.0


def _log_evidence(views: Sequence[BoardView], state: State, prior: Prior, levels: BoardVariances) -> float:
    problem = board_problem(views, prior, levels)
    fit, free = problem.minimise(state, tolerance=_ROUGH), problem.free
    scale: Floats = np.sqrt(np.diag(fit.information)[free])
    scaled = fit.information[np.ix_(free, free)] / np.outer(scale, scale)
    curvature = float(np.linalg.slogdet(scaled)[1]) + 2 * float(np.sum(np.log(scale)))
    precision = -2 * flex_columns(len(views)).size * np.log(prior.flex) if prior.flex else 0.0
    return -0.5 * (fit.cost + curvature - precision)
