"""Where to hold the board next: the pose that lowers the sigmas of the intrinsics most, by the information matrix."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.boards.estimate import Estimate
from calib.boards.parameters import (
    INTRINSIC_COLUMNS,
    SHARED,
    PlacedBoard,
    State,
    is_seen,
    points_along,
    predict_corners,
    predict_matches,
)
from calib.geometry import PER_POSE, Pose, Size, rotation_about
from calib.numerics import Floats, inverse_of

_PLACES = (0.25, 0.5, 0.75)  # positions across and down the projector's picture
_DISTANCES = {"nearer than most so far": 0.8, "as far away as most so far": 1.0, "farther away than most so far": 1.25}
_TILT = np.radians(30.0)
_SIDES = ("right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right")
_GRID = 7
_CELLS = 250.0  # cells per view

_ACROSS, _DOWN = ("left", "middle", "right"), ("top", "middle", "bottom")


@dataclass(frozen=True)
class NextPose:
    """`words` say how to hold the board; `gain`: of the sigmas of the intrinsics, root mean square, now over then."""

    words: str
    gain: float


def best_next_pose(estimate: Estimate, sizes: tuple[Size, Size]) -> NextPose | None:
    """Among boards in nine parts of the projected picture, at three distances, facing it or tilted to eight sides.

    None if neither picture would hold any of them.
    """
    free = estimate.prior.sigma > 0
    known = inverse_of(estimate.covariance[np.ix_(free, free)])
    scale = _scale(estimate.state)
    best: NextPose | None = None
    before = _size(estimate.covariance, scale)
    for words, state in _candidates(estimate.state, sizes):
        if not _is_whole(estimate, state, sizes):
            continue
        covariance = np.zeros_like(estimate.covariance)
        covariance[np.ix_(free, free)] = inverse_of(known + _information(estimate, state)[np.ix_(free, free)])
        gain = before / _size(covariance, scale)
        if best is None or gain > best.gain:
            best = NextPose(words, gain)
    return best


def _scale(state: State) -> Floats:
    """Makes principal points comparable with logarithms of focals."""
    scale = np.ones(len(INTRINSIC_COLUMNS))
    scale[1:3], scale[4:6] = 1 / state.camera[0], 1 / state.projector[0]
    return scale


def _size(covariance: Floats, scale: Floats) -> float:
    return float(np.sqrt(np.mean(covariance.diagonal()[INTRINSIC_COLUMNS] * scale**2)))


def _candidates(state: State, sizes: tuple[Size, Size]) -> Iterator[tuple[str, State]]:
    usual = float(np.median([(state.pose @ board.pose).translation[2] for board in state.boards]))
    for (i, x), (j, y), (words, factor) in product(enumerate(_PLACES), enumerate(_PLACES), _DISTANCES.items()):
        pixel = np.array([[x * sizes[1].width, y * sizes[1].height]])
        there = points_along(state.projector, pixel, factor * usual)[0]
        middle = state.pose.undo(there)
        place = "middle" if i == j == 1 else f"{_DOWN[j]} {_ACROSS[i]}"
        for tilted, turn in _turns():
            board = PlacedBoard(Pose(turn, middle))
            yield f"{tilted}, in the {place} of the projected picture, {words}", replace(state, boards=(board,))


def _turns() -> Iterator[tuple[str, Floats]]:
    yield "facing the camera", np.eye(3)
    for k, side in enumerate(_SIDES):
        towards = np.pi / 4 * k
        # Rotated about the perpendicular axis, so that its side comes nearer.
        yield (
            f"tilted with its {side} side towards the rig",
            rotation_about(_TILT * np.array([-np.sin(towards), np.cos(towards), 0.0])),
        )


def _points(estimate: Estimate) -> tuple[Floats, Floats]:
    """Corners of the board, and a grid over it."""
    corners = estimate.views[0].points
    low, high = corners.min(axis=0), corners.max(axis=0)
    grid = np.stack(np.meshgrid(*(np.linspace(low[k], high[k], _GRID) for k in (0, 1))), axis=-1).reshape(-1, 2)
    return corners, grid


def _is_whole(estimate: Estimate, state: State, sizes: tuple[Size, Size]) -> bool:
    corners, _ = _points(estimate)
    board = state.boards[0]
    points = board.pose @ np.column_stack([corners, np.zeros(len(corners))])
    in_camera = is_seen(state.camera, points, sizes[0]).all()
    return bool(in_camera and is_seen(state.projector, state.pose @ points, sizes[1]).all())


def _information(estimate: Estimate, state: State) -> Floats:
    """Information of a view of this board on the common parameters, with an unknown pose, (SHARED, SHARED)."""
    corners, grid = _points(estimate)
    _, by_corners, _ = predict_corners(state, corners, 0)
    camera_px, _, _ = predict_corners(state, grid, 0)
    _, by_cells, _ = predict_matches(state, camera_px, 0)
    of_cells = float(np.median(np.concatenate(estimate.levels.cells))) * len(grid) / _CELLS
    whole = np.zeros((SHARED + PER_POSE, SHARED + PER_POSE))
    for jacobian, variance in ((by_corners, float(np.median(estimate.levels.corners))), (by_cells, of_cells)):
        rows = jacobian[:, :, : SHARED + PER_POSE].reshape(-1, SHARED + PER_POSE)
        whole += rows.T @ rows / variance
    pose = slice(SHARED, None)
    across = whole[:SHARED, pose]
    return whole[:SHARED, :SHARED] - across @ np.linalg.solve(whole[pose, pose], across.T)
