"""Where the descent begins: the camera from a sweep of focals, the projector from the points that it lights.

For a trial focal each board has its pose in closed form (Collins and Bartoli 2014, through OpenCV); the few best trials
are refined. With the camera known, all matches have points in space, and those of all boards are not in one plane: the
projector's matrix is then linear in them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from calib.boards.likelihood import BoardFit, BoardProblem, BoardVariances, BoardView, Prior, board_problem
from calib.boards.parameters import (
    BEND,
    CAMERA,
    FOCAL,
    LENS,
    PER_BEND,
    POSE,
    PROJECTOR,
    PlacedBoard,
    State,
    meet,
    rays_of,
)
from calib.closed_form import resected
from calib.geometry import Pose
from calib.numerics import Floats, distinct, evenly

_SHORTEST, _LONGEST, _TRIALS = 0.35, 8.0, 14  # focals in units of the image's longer side
_FINALISTS = 3
_ROUGH_PX = 1.0  # assumed noise before it is estimated
_SAMPLE = 60  # cells per view
_ROUGH, _STEPS = 0.1, 20  # tolerance in cost
_DIFFERENT = 0.02  # of log f


def starts(
    views: Sequence[BoardView],
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    reach: float,
    prior: Prior,
) -> list[BoardFit]:
    """Rough fits of the views with different focals, best first."""
    levels = rough_levels(views)
    rough = prior.knowing(_all_but(CAMERA.start + LENS.start, PROJECTOR.start + LENS.start))
    states = [
        with_projector
        for state in _cameras(views, camera_size, reach, rough, levels)
        for with_projector in _projectors(views, state, projector_size)
    ]
    return _distinct([fit for fit in best_first(views, states, rough) if np.isfinite(fit.cost)])


def best_first(views: Sequence[BoardView], states: Sequence[State], prior: Prior) -> list[BoardFit]:
    """The rough fits that the states lead to."""
    problem = board_problem(views, prior, rough_levels(views))
    fits = [problem.minimise(state, tolerance=_ROUGH, steps=_STEPS) for state in states]
    return sorted(fits, key=lambda fit: fit.cost)


def _distinct(fits: list[BoardFit]) -> list[BoardFit]:
    """Those with other focals than better ones before them."""
    focals = np.log([[fit.state.camera[0], fit.state.projector[0]] for fit in fits]).reshape(-1, 2)
    return [fits[k] for k in distinct(len(fits), lambda k: np.abs(focals - focals[k]).max(axis=1) <= _DIFFERENT)]


def rough_levels(views: Sequence[BoardView]) -> BoardVariances:
    """Noise of one pixel everywhere."""
    return BoardVariances(np.full(len(views), _ROUGH_PX), tuple(np.full(len(view.cells), _ROUGH_PX) for view in views))


def _all_but(*free: int) -> list[int]:
    """Aspects, lens terms and bend, but for these."""
    of_devices = [device.start + k for device in (CAMERA, PROJECTOR) for k in (1, 4, 5, 6, 7, 8)]
    return [column for column in (*of_devices, *range(BEND.start, BEND.stop)) if column not in free]


def _cameras(
    views: Sequence[BoardView], size: tuple[int, int], reach: float, prior: Prior, levels: BoardVariances
) -> Iterator[State]:
    """States whose camera and poses fit the corners; the projector is undetermined."""
    trials = []
    for focal in np.geomspace(_SHORTEST, _LONGEST, _TRIALS) * max(size):
        camera = np.array([focal, 1.0, (size[0] - 1) / 2, (size[1] - 1) / 2, 0.0, 0.0, 0.0, 0.0, 0.0])
        posed = [pose_of(view.points, view.corners_px, camera) for view in views]
        cost = sum(np.minimum(error**2, 100.0 * _ROUGH_PX**2) for _, error in posed)
        beside = Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))
        boards = tuple(board for board, _ in posed)
        trials.append((cost, State(camera, camera, beside, np.zeros(PER_BEND), reach, boards)))
    trials.sort(key=lambda trial: trial[0])
    free = prior.free(len(views))
    free[PROJECTOR] = free[POSE] = False
    problem = board_problem(views, prior, levels, free=free, matches=False)
    fits: list[BoardFit] = []
    for _, state in trials[:_FINALISTS]:
        fit = problem.minimise(state, tolerance=_ROUGH, steps=_STEPS)
        fit = _turned_over(views, fit, problem)
        if all(abs(np.log(fit.state.camera[0] / earlier.state.camera[0])) > _DIFFERENT for earlier in fits):
            fits.append(fit)
    yield from (fit.state for fit in sorted(fits, key=lambda fit: fit.cost))


def _turned_over(views: Sequence[BoardView], fit: BoardFit, problem: BoardProblem) -> BoardFit:
    """The same with each board in the other of the two poses that a weak perspective leaves, where that is better."""
    boards = tuple(pose_of(view.points, view.corners_px, fit.state.camera)[0] for view in views)
    turned = problem.minimise(replace(fit.state, boards=boards), tolerance=_ROUGH, steps=_STEPS)
    return min(fit, turned, key=lambda candidate: candidate.cost)


def pose_of(points: Floats, pixels: Floats, camera: Floats) -> tuple[PlacedBoard, float]:
    """A flat board's pose from its corners (N, 2) and their pixels (N, 2), and the root mean square error in px."""
    rays = np.ascontiguousarray(rays_of(camera, pixels))
    usable = np.isfinite(rays).all(axis=1)
    flat = np.concatenate([points, np.zeros((len(points), 1))], axis=1)[usable]
    _, turns, places, errors = cv2.solvePnPGeneric(flat, rays[usable], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    best = int(np.argmin(np.asarray(errors).ravel()))
    return PlacedBoard(_posed(turns[best], places[best])), float(np.asarray(errors).ravel()[best]) * float(
        camera[FOCAL]
    )


def _posed(turn: cv2.typing.MatLike, place: cv2.typing.MatLike) -> Pose:
    """A rotation vector and a translation of OpenCV's solvers, (3, 1) each."""
    return Pose(np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(place, np.float64).ravel())


def _projectors(views: Sequence[BoardView], state: State, size: tuple[int, int]) -> Iterator[State]:
    """The state with the projector that the lit points give, and with one for each of several focals."""
    points, pixels = _lit(views, state)
    solved = resected(points, pixels)
    if solved is not None:
        matrix, pose = solved
        if 0.1 < matrix[0, 0] / size[0] < 20 and 0.5 < matrix[1, 1] / matrix[0, 0] < 2:
            yield _with_projector(state, matrix[0, 0], matrix[:2, 2], pose)
    trials = []
    for focal in np.geomspace(0.5, 5.0, 6) * size[0]:
        for centre in (
            np.array([(size[0] - 1) / 2, (size[1] - 1) / 2 + share * size[1]]) for share in (0.0, 0.5, -0.5)
        ):
            matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
            is_solved, turn, place = cv2.solvePnP(points, pixels, matrix, None, flags=cv2.SOLVEPNP_SQPNP)
            if is_solved:
                image, _ = cv2.projectPoints(points, turn, place, matrix, None)
                error = float(np.median(np.linalg.norm(image.reshape(-1, 2) - pixels, axis=1)))
                trials.append((error, _with_projector(state, float(focal), centre, _posed(turn, place))))
    if trials:
        yield min(trials, key=lambda trial: trial[0])[1]


def _with_projector(state: State, focal: float, centre: Floats, pose: Pose) -> State:
    return replace(state, projector=np.array([focal, 1.0, *centre, 0, 0, 0, 0, 0], np.float64), pose=pose)


def _lit(views: Sequence[BoardView], state: State) -> tuple[Floats, Floats]:
    """Points (N, 3) in the camera's frame that cells of matches see, and their projector pixels (N, 2)."""
    points, pixels = [], []
    for i, view in enumerate(views):
        few = evenly(np.ones(len(view.cells), np.bool_), _SAMPLE)
        met = meet(state, rays_of(state.camera, view.cells.camera_px[few]), i)
        board = state.boards[i].pose
        points.append(met @ board.rotation[:, :2].T + board.translation)
        pixels.append(view.cells.projector_px[few])
    return np.concatenate(points), np.concatenate(pixels)
