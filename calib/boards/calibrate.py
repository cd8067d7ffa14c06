"""Views of a board → a calibration with its uncertainty and what tests it, or a refusal with a reason.

The board itself: its orientation in each view, and whether its bend varies between poses.

A chessboard with odd numbers of corners is symmetric under half a turn, one with as many rows as columns under a
quarter. A bend, or an irregular print, is not.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.boards.acceptance import (
    FEWEST_VIEWS,
    BoardCoverage,
    coverage_of,
    no_rig,
    refuse_untrustworthy,
    straightness,
    too_few,
)
from calib.boards.estimate import Estimate, Halves, Prediction, estimate, halves, leave_one_out
from calib.boards.likelihood import BoardFit, BoardVariances, BoardView, Prior, board_problem, device_prior
from calib.boards.parameters import (
    CAMERA,
    DIRECTION,
    LENGTH,
    PROJECTOR,
    ROTATION,
    PlacedBoard,
    State,
    flex_columns,
)
from calib.boards.starts import best_first, rough_levels, starts
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, DeviceSigmas, Intrinsics, Pose, Sigmas, Size
from calib.numerics import Floats
from calib.refinement import ORDINARY_LENSES, LensPrior
from calib.refusal import RefusalError

_CLEARLY = 2.0  # in cost
_PASSES = 2
_ROUGH = 0.03  # tolerance in cost
_FLEXES = (3e-4, 1e-3, 3e-3)  # of half the board's length
_EVIDENT = 3.0  # nats
_BEND_TERMS = 7
_OUTLIER_SIGMAS, _OUTLIER_RATIO, _OUTLIER_PX = 4.0, 4.0, 0.2
_MOST_OUTLIERS = 0.34  # largest share of the views that are left out
_STEPS = 20
_SURPRISING = 1.3  # ratio of prediction errors to the expected ones

OUTLIER_BOARD = FindingKind(
    "outlier-board",
    "A capture of a board was left out: its matches are not where the other boards predict them.",
    "Hold the board still while it is captured, on something firm.",
    ("off_px", "usual_px"),
)
POOR_CORNERS = FindingKind(
    "poor-corners",
    "The corners of the board were found poorly in some captures, which have less weight.",
    "Focus the camera on the board, and light it evenly.",
    ("usual_px",),
)
BENT_BOARD = FindingKind(
    "bent-board",
    "The board is bent, or bends otherwise in every pose; it was taken into account.",
    "Glue the board to something flat and firm.",
    ("bend_thousandths", "flex_thousandths"),
)
ENLARGED_SIGMAS = FindingKind(
    "enlarged-sigmas",
    "The boards predict each other worse than their residuals allow, so all sigmas were enlarged.",
    "Make sure that nothing moves or is refocused between the captures, and that the board is flat.",
    ("enlarged_ratio",),
)
UNTESTED_HALVES = FindingKind(
    "untested-halves",
    "There are too few boards to compare one half with the other.",
    "Take six captures of the board or more.",
)
BOARDS_CONTRADICT = FindingKind(
    "boards-contradict",
    "Too many boards are elsewhere than the others predict.",
    "The rig, its zoom or its focus may have changed between the captures, or the board moved during one: take them "
    "again.",
    ("off_px", "usual_px"),
)


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


@dataclass(frozen=True)
class Board:
    """`reach`: half its longer side, in the unit of its corners; `turns`: number of symmetric orientations."""

    reach: float
    turns: int
    unit: str


@dataclass(frozen=True)
class OutlierView:
    """A view that was left out, and by how much the others mispredict its matches."""

    name: str
    error_px: float
    usual_px: float


@dataclass(frozen=True)
class BoardCalibration:
    """A calibration from boards, in their unit."""

    calibration: Calibration
    """With the sigmas."""
    estimate: Estimate
    """With the final covariance."""
    predictions: tuple[Prediction, ...]
    """Each board by the others."""
    halves: Halves | None
    """Half of the boards compared with the others, None if too few."""
    enlarged: float
    """Factor on the sigmas, if prediction errors, or a flat minimum, showed them too small; otherwise 1."""
    left_out: tuple[OutlierView, ...]
    """Outlier views."""
    coverage: BoardCoverage
    findings: tuple[Finding, ...]


def calibrate_boards(
    views: Sequence[BoardView],
    camera_size: Size,
    projector_size: Size,
    board: Board,
    *,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
) -> BoardCalibration:
    """Calibrate one unchanged rig from views of one board, by maximum likelihood. `lenses`: priors on those of camera
    and projector.

    Raises RefusalError without a trustworthy calibration.
    """
    if len(views) < FEWEST_VIEWS:
        raise too_few(len(views))
    prior = device_prior(camera_size, projector_size, _BEND_TERMS, lenses)
    begun = starts(views, camera_size, projector_size, board.reach, prior)
    if not begun:
        raise no_rig(None)
    solution = estimated(views, begun[0].state, prior, board)
    names = [view.name for view in solution.views]
    rigid = replace(solution.state, boards=tuple(PlacedBoard(board.pose) for board in solution.state.boards))
    minima = rigid, *(fit.state for fit in begun[1:])

    def anew(some: Sequence[BoardView]) -> Estimate:
        again = starts(some, camera_size, projector_size, board.reach, prior)
        return estimated(some, again[0].state, prior, board) if again else nearby(some)

    def nearby(some: Sequence[BoardView]) -> Estimate:
        """From the best of the minima of all views."""
        chosen = [names.index(view.name) for view in some]
        fits = best_first(some, [state.of_views(chosen) for state in minima], prior)
        return estimated(some, fits[0].state, prior, board)

    sizes = camera_size, projector_size
    # Parameters that all boards together do not determine stay undetermined without one of them.
    refuse_untrustworthy(solution, (), coverage_of(solution.views, solution.state, *sizes), sizes)
    solution, predictions, left_out = _without_outliers(solution, anew, nearby)
    coverage = coverage_of(solution.views, solution.state, *sizes)
    surprise = float(np.sqrt(np.mean([prediction.sigmas**2 for prediction in predictions])))
    enlarged = straightness(solution) * (surprise if surprise > _SURPRISING else 1.0)
    solution = replace(solution, covariance=solution.covariance * enlarged**2)
    refuse_untrustworthy(solution, _others(solution, begun, views), coverage, sizes)
    calibration = calibration_from(solution, camera_size, projector_size, board.unit)
    tested = halves(solution, anew)
    return BoardCalibration(
        calibration,
        solution,
        predictions,
        tested,
        enlarged,
        left_out,
        coverage,
        tuple(_findings(solution, left_out, enlarged, tested)),
    )


def estimated(views: Sequence[BoardView], start: State, prior: Prior, board: Board) -> Estimate:
    """From views of one board, oriented consistently, with the flex that they show."""
    rough = estimate(views, start, prior, rough_levels(views))
    if board.turns > 1:
        views, start = oriented_consistently(views, rough.state, prior, rough.levels, board.turns)
        rough = estimate(views, start, prior, rough.levels)
    flex = flex_of(views, rough.state, rough.prior, rough.levels)
    return estimate(views, rough.state, replace(prior, flex=flex), rough.levels) if flex else rough


def _without_outliers(
    solution: Estimate,
    anew: Callable[[Sequence[BoardView]], Estimate],
    nearby: Callable[[Sequence[BoardView]], Estimate],
) -> tuple[Estimate, tuple[Prediction, ...], tuple[OutlierView, ...]]:
    """The estimate without views that the others predict badly: a board that moved, or another board."""
    left_out: list[OutlierView] = []
    most = int(_MOST_OUTLIERS * len(solution.views))
    while True:
        predictions = leave_one_out(solution, nearby)
        errors = np.array([prediction.error_px for prediction in predictions])
        worst = int(np.argmax(errors))
        usual = float(np.median(np.delete(errors, worst)))
        odd = errors[worst] > max(_OUTLIER_RATIO * usual, _OUTLIER_PX) and predictions[worst].sigmas > _OUTLIER_SIGMAS
        if not odd:
            return solution, predictions, tuple(left_out)
        if len(left_out) == most or len(errors) == FEWEST_VIEWS:
            raise RefusalError(
                BOARDS_CONTRADICT,
                f"The boards contradict each other: {predictions[worst].name} is {errors[worst]:.2g} projector px from "
                f"where the others predict it, {usual:.2g} px is usual, and {len(left_out)} were already left out.",
                "The rig, its zoom or its focus may have changed between the captures, or the board may have moved "
                "during one.",
                {"off_px": float(errors[worst]), "usual_px": float(usual)},
            )
        left_out.append(OutlierView(predictions[worst].name, float(errors[worst]), usual))
        solution = anew([*solution.views[:worst], *solution.views[worst + 1 :]])


def _others(solution: Estimate, begun: Sequence[BoardFit], views: Sequence[BoardView]) -> list[BoardFit]:
    """The further minima, refined like the best one."""
    names = [view.name for view in views]
    chosen = [names.index(view.name) for view in solution.views]
    problem, further = board_problem(solution.views, solution.prior, solution.levels), []
    for fit in begun[1:]:
        state = fit.state.of_views(chosen)
        further.append(problem.minimise(state, tolerance=0.1, steps=_STEPS))
    return further


def calibration_from(solution: Estimate, camera_size: Size, projector_size: Size, unit: str) -> Calibration:
    """An estimate's devices and motion, with its sigmas."""
    state, sigma = solution.state, np.sqrt(solution.covariance.diagonal())
    turn = np.degrees(sigma[ROTATION])
    sigmas = Sigmas(
        DeviceSigmas.of_device(state.camera, solution.covariance[CAMERA, CAMERA]),
        DeviceSigmas.of_device(state.projector, solution.covariance[PROJECTOR, PROJECTOR]),
        (float(turn[0]), float(turn[1]), float(turn[2])),
        float(np.degrees(np.hypot(*sigma[DIRECTION]))),
        known_baseline=float(sigma[LENGTH]) * state.pose.distance,
    )
    return Calibration(
        Intrinsics.of_device(state.camera, camera_size),
        Intrinsics.of_device(state.projector, projector_size),
        state.pose,
        unit,
        sigmas,
    )


def _findings(
    estimated: Estimate, left_out: Sequence[OutlierView], enlarged: float, tested: Halves | None
) -> Iterator[Finding]:
    for odd in left_out:
        yield Finding(
            OUTLIER_BOARD,
            Severity.NOTE,
            f"{odd.name} was left out: its matches are {odd.error_px:.2g} projector px from where the other boards "
            f"predict them, {odd.usual_px:.2g} px is usual. The board may have moved during that capture.",
            data={"off_px": odd.error_px, "usual_px": odd.usual_px},
        )
    usual_px = float(np.median(estimated.corner_px))
    blurred = [
        f"{view.name} ({sigma:.2g} px)"
        for view, sigma in zip(estimated.views, estimated.corner_px, strict=True)
        if sigma > 3 * usual_px
    ]
    if blurred:
        yield Finding(
            POOR_CORNERS,
            Severity.NOTE,
            f"Corners were found poorly in {', '.join(blurred)}, where {usual_px:.2g} px is usual: they have less "
            "weight. The cause is blur, or uneven light on the board.",
            data={"usual_px": usual_px},
        )
    if estimated.state.bend.any():
        bend = 1000 * float(np.abs(estimated.state.bend[:3]).max())
        message = f"The board is bent by {bend:.2g} thousandths of half its length, which was taken into account."
        yield Finding(BENT_BOARD, Severity.NOTE, message, data={"bend_thousandths": bend})
    if estimated.prior.flex:
        flex = 1000 * estimated.prior.flex
        message = f"Its bend varies between poses by about {flex:.2g} thousandths."
        yield Finding(BENT_BOARD, Severity.NOTE, message, data={"flex_thousandths": flex})
    if enlarged > 1:
        yield Finding(
            ENLARGED_SIGMAS,
            Severity.NOTE,
            f"All sigmas are {enlarged:.2g} times those of the residuals: the boards predict each other worse than the "
            "residuals allow.",
            data={"enlarged_ratio": enlarged},
        )
    if tested is None:
        yield Finding(UNTESTED_HALVES, Severity.NOTE, "There are too few boards to compare one half with the other.")
