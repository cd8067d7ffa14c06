"""Cross-validation of boards: each predicted by the others, and one half compared with the other.

Reprojection errors are small with enough parameters; these are prediction errors. Both are compared with the
covariance, and so test it, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.boards.estimate import Estimate
from calib.boards.likelihood import BoardVariances, BoardView, board_problem
from calib.boards.parameters import CAMERA, INTRINSIC_COLUMNS, PER_FLEX, PROJECTOR, SHARED, PlacedBoard, predict_matches
from calib.geometry import PER_POSE
from calib.numerics import Floats

_FEWEST_OF_A_HALF = 2
_EXCUSED = 9.0  # variances this many times the usual are down-weighted
_USEFUL_HALF = 0.15  # sigma of a log focal length beyond which a half by itself is not compared


@dataclass(frozen=True)
class Prediction:
    """A left out view, predicted by the others: its matches should be where its corners put it.

    `error_px`: root mean square distance in the projector; `expected_px`: from the covariance and the noise; `moved`
    (SHARED,): displacement of the estimate without it.
    """

    name: str
    error_px: float
    expected_px: float
    moved: Floats

    @property
    def sigmas(self) -> float:
        """The error over the expected one."""
        return self.error_px / self.expected_px


@dataclass(frozen=True)
class Halves:
    """Two halves of the views, by name, calibrated apart.

    `difference` and its `sigma` (6,): of log f, x_0, y_0 of the camera and of the projector.
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    difference: Floats
    sigma: Floats

    @property
    def sigmas(self) -> float:
        """Root mean square of the differences in their sigmas."""
        return float(np.sqrt(np.mean((self.difference / self.sigma) ** 2)))


def leave_one_out(found: Estimate, again: Callable[[Sequence[BoardView]], Estimate]) -> tuple[Prediction, ...]:
    """Each view predicted by the others; empty for fewer than three.

    `again`: estimates from some of the views.
    """
    count = len(found.views)
    if count < 3:
        return ()
    return tuple(_predicted(found, i, again([*found.views[:i], *found.views[i + 1 :]])) for i in range(count))


def _predicted(found: Estimate, left_out: int, rest: Estimate) -> Prediction:
    view = found.views[left_out]
    moved = rest.state.additive() - found.state.additive()
    board = found.state.boards[left_out]
    alone = replace(rest.state, boards=(PlacedBoard(board.pose),))
    levels = _usual_levels(found, left_out)
    free = np.zeros(alone.size, np.bool_)
    free[SHARED : SHARED + PER_POSE] = True
    posed = board_problem([view], found.prior, levels, free=free, matches=False).minimise(alone)
    predicted, jacobian, _ = predict_matches(posed.state, view.cells.camera_px, 0)
    residual = predicted - view.cells.projector_px
    pose = slice(SHARED, SHARED + PER_POSE)
    of_pose = np.asarray(np.linalg.inv(posed.information[pose, pose]), np.float64)
    # The pose follows the common parameters, so that its corners stay at their observed pixels.
    by_shared = jacobian[:, :, :SHARED] - jacobian[:, :, pose] @ (of_pose @ posed.information[pose, :SHARED])
    variance = _variance(by_shared, rest.covariance) + _variance(jacobian[:, :, pose], of_pose)
    if found.prior.flex:
        variance += _variance(jacobian[:, :, -PER_FLEX:], found.prior.flex**2 * np.eye(PER_FLEX))
    usual_px = float(np.median([noise.smooth_px for noise in found.noise]))  # more is an error of the view, not noise
    variance += 2 * levels.cells[0] + min(found.noise[left_out].smooth_px, usual_px) ** 2
    # Outliers among the cells are down-weighted, as by Huber's loss.
    square = np.minimum(np.sum(residual**2, axis=1), 9 * np.maximum(variance, np.median(np.sum(residual**2, axis=1))))
    return Prediction(view.name, float(np.sqrt(square.mean())), float(np.sqrt(variance.mean())), moved)


def _usual_levels(found: Estimate, view: int) -> BoardVariances:
    """A view's own levels without its smooth misfit, unless they are far above those of the others.

    Otherwise a board that moved would look noisy, and be excused.
    """
    independent = [cells / noise.inflation for cells, noise in zip(found.levels.cells, found.noise, strict=True)]
    usual = float(np.median([np.median(variances) for variances in independent]))
    own = independent[view] * min(1.0, _EXCUSED * usual / float(np.median(independent[view])))
    corners = found.levels.corners
    return BoardVariances(np.minimum(corners[[view]], _EXCUSED * np.median(corners)), (own,))


def _variance(jacobian: Floats, covariance: Floats) -> Floats:
    """Of x and y together, (N,)."""
    variance: Floats = np.einsum("nka,ab,nkb->n", jacobian, covariance, jacobian, optimize=True)
    return variance


def halves(found: Estimate, anew: Callable[[Sequence[BoardView]], Estimate]) -> Halves | None:
    """Every second view compared with the others, each half estimated `anew`, from the starts on.

    None if a half has too few views, or determines nothing.
    """
    count = len(found.views)
    parts = [list(range(start, count, 2)) for start in (0, 1)]
    if min(len(part) for part in parts) < _FEWEST_OF_A_HALF:
        return None
    one, other = (anew([found.views[i] for i in part]) for part in parts)
    variances = [part.covariance.diagonal() for part in (one, other)]
    focals = [CAMERA.start, PROJECTOR.start]
    if not all(np.sqrt(variance[focals]).max() < _USEFUL_HALF for variance in variances):
        return None
    difference = one.state.additive() - other.state.additive()
    sigma = np.sqrt(variances[0] + variances[1])
    names = [tuple(found.views[i].name for i in part) for part in parts]
    return Halves(names[0], names[1], difference[INTRINSIC_COLUMNS], sigma[INTRINSIC_COLUMNS])
