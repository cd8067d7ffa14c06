"""Which calibrations from boards deserve to be used, and why others do not: the reasons that a person can do something
about are in how the boards were held.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from calib.boards.estimate import Estimate
from calib.boards.likelihood import BoardFit, BoardView, board_problem
from calib.boards.parameters import (
    CAMERA,
    FOCAL,
    PROJECTOR,
    SHARED,
    State,
    is_seen,
    points_along,
    project_rays,
    rays_of,
)
from calib.finding import FindingKind
from calib.geometry import Size
from calib.numerics import Bools, Floats
from calib.refusal import AMBIGUOUS, UNDETERMINED_FOCAL, RefusalError

FEWEST_VIEWS = 3
_USEFUL_SIGMA = 0.03  # sigma of a log focal length
_HOPELESSLY_PARALLEL_DEG = 5.0  # defects of print or lens then outweigh the perspective
_USEFUL_RAY = 0.0025  # share of a picture's longer side, anywhere in the common view
_CLEARLY_WORSE = 9.0  # in cost
_WALK_SIGMAS, _NEARLY_PARABOLIC = 2.0, 1.2
# Spreads below these limits are named as reasons.
_PARALLEL_DEG = 15.0
_SAME_DISTANCE = 1.15
_SMALL_COVERAGE = 0.3
_GRID = 13

_ADVICE = (
    "Take six to ten captures with the board tilted by 20 to 45 degrees, to either side and up and down, at different "
    "distances, so that together they fill both pictures."
)

TOO_FEW_BOARDS = FindingKind(
    "too-few-boards",
    "Fewer than three views of a printed board are usable.",
    "Take six to ten captures of the board, tilted to different sides.",
    ("views",),
)
BOARDS_MISFIT = FindingKind(
    "boards-misfit",
    "No camera and projector explain the boards.",
    "Check the board's kind and counts, that it is flat, and that nothing moved during a capture.",
)
PARALLEL_BOARDS = FindingKind(
    "parallel-boards",
    "All boards are nearly parallel, which does not determine focal lengths.",
    "Tilt the board by 20 to 45 degrees, to either side and up and down.",
    ("tilt_deg",),
)
UNDETERMINED_LENS = FindingKind(
    "undetermined-lens",
    "The boards do not determine a device's lens over the whole common view.",
    "Take captures in which the boards fill what is still empty of both pictures.",
    ("ray_sigma_px",),
)


@dataclass(frozen=True)
class BoardCoverage:
    """How the boards were held: the largest angle between two of them, the farthest over the nearest, and the share of
    each picture's area that the hull of all their corners, or lit cells, has.
    """

    tilt_deg: float
    distances: float
    camera: float
    projector: float

    @property
    def reasons(self) -> list[str]:
        """What is wrong with it, in words."""
        reasons = []
        if self.tilt_deg < _PARALLEL_DEG:
            reasons.append(f"the boards are nearly parallel to each other, within {self.tilt_deg:.0f} degrees")
        if self.distances < _SAME_DISTANCE:
            reasons.append(f"they are all at about the same distance, within {100 * (self.distances - 1):.0f} %")
        for name, share in (("camera", self.camera), ("projector", self.projector)):
            if share < _SMALL_COVERAGE:
                reasons.append(f"they cover only {100 * share:.0f} % of the {name}'s picture")
        return reasons


def coverage_of(views: Sequence[BoardView], state: State, camera_size: Size, projector_size: Size) -> BoardCoverage:
    """Of views and where their boards are."""
    normals = [state.normal(i) for i in range(len(views))]
    angles = [np.degrees(np.arccos(min(abs(float(a @ b)), 1.0))) for a, b in combinations(normals, 2)]
    distances = [board.pose.distance for board in state.boards]
    return BoardCoverage(
        float(max(angles, default=0.0)),
        max(distances) / min(distances),
        _hull_share([view.corners_px for view in views], camera_size),
        _hull_share([view.cells.projector_px for view in views], projector_size),
    )


def _hull_share(pixels: Sequence[Floats], size: Size) -> float:
    hull = cv2.convexHull(np.concatenate(pixels).astype(np.float32))
    return float(cv2.contourArea(hull)) / (size.width * size.height)


def too_few(count: int) -> RefusalError:
    """The refusal of fewer views than determine anything."""
    return RefusalError(
        TOO_FEW_BOARDS,
        f"{count} usable {'view' if count == 1 else 'views'} of the board; at least three are needed.",
        _ADVICE,
        {"views": float(count)},
    )


def no_rig(coverage: BoardCoverage | None) -> RefusalError:
    """The refusal where no devices explain the views."""
    return RefusalError(BOARDS_MISFIT, "No camera and projector explain these boards" + _because(coverage), _ADVICE)


def refuse_untrustworthy(
    estimate: Estimate, rivals: Sequence[BoardFit], coverage: BoardCoverage, sizes: tuple[Size, Size]
) -> None:
    """Raise RefusalError where the boards do not determine both devices, everywhere in their pictures and uniquely."""
    sigma = np.sqrt(estimate.covariance.diagonal())
    if coverage.tilt_deg < _HOPELESSLY_PARALLEL_DEG:
        raise RefusalError(
            PARALLEL_BOARDS,
            "Parallel boards do not determine focal lengths" + _because(coverage),
            _ADVICE,
            {"tilt_deg": coverage.tilt_deg},
        )
    for name, device in (("camera", CAMERA), ("projector", PROJECTOR)):
        if not sigma[device][FOCAL] < _USEFUL_SIGMA:
            raise RefusalError(
                UNDETERMINED_FOCAL,
                f"These boards hardly determine the {name}'s focal length: its sigma is "
                f"{100 * sigma[device][FOCAL]:.2g} %" + _because(coverage),
                _ADVICE,
                {"sigma_percent": 100 * float(sigma[device][FOCAL])},
            )
    for name, sigmas, size in zip(("camera", "projector"), ray_sigmas(estimate, sizes), sizes, strict=True):
        worst = float(np.nanmax(sigmas, initial=0.0))
        if not worst < _USEFUL_RAY * max(size):
            raise RefusalError(
                UNDETERMINED_LENS,
                f"These boards do not determine the {name}'s lens over the whole common view: the sigma of a ray is "
                f"up to {worst:.2g} px" + _because(coverage),
                _ADVICE,
                {"ray_sigma_px": worst},
            )
    for rival in rivals:
        apart = np.abs(rival.state.additive() - estimate.state.additive())[[CAMERA.start, PROJECTOR.start]]
        if rival.cost - estimate.fit.cost < _CLEARLY_WORSE and np.any(
            apart > 2 * sigma[[CAMERA.start, PROJECTOR.start]]
        ):
            raise RefusalError(
                AMBIGUOUS,
                f"Ambiguous: {_focals(estimate.fit)}, and {_focals(rival)}, explain these boards almost equally well"
                + _because(coverage),
                _ADVICE,
                {
                    "camera_focal_px": float(estimate.fit.state.camera[0]),
                    "other_camera_focal_px": float(rival.state.camera[0]),
                },
            )


def ray_sigmas(estimate: Estimate, sizes: tuple[Size, Size]) -> tuple[Floats, Floats]:
    """Standard deviations (13, 13) of the rays of camera and projector, in px over either picture.

    NaN where the other device does not see the same, at the boards' distance. A rotation of the device is no error of
    its lens, because the motion between the devices compensates for it.
    """
    every, state = (_grid(sizes[0]), _grid(sizes[1])), estimate.state
    in_view = _seen_by_both(state, every, sizes)
    return (
        _lens_sigmas(state.camera, every[0], estimate.covariance[CAMERA, CAMERA], in_view[0]),
        _lens_sigmas(state.projector, every[1], estimate.covariance[PROJECTOR, PROJECTOR], in_view[1]),
    )


def rays_seen(state: State, sizes: tuple[Size, Size]) -> tuple[Floats, Floats]:
    """Pixels (N, 2) of the camera, and of the projector (M, 2), over what both see at the boards' distance."""
    every = _grid(sizes[0]), _grid(sizes[1])
    camera, projector = _seen_by_both(state, every, sizes)
    return every[0][camera], every[1][projector]


def _seen_by_both(state: State, pixels: tuple[Floats, Floats], sizes: tuple[Size, Size]) -> tuple[Bools, Bools]:
    """Mask of the pixels of either device that see, at the boards' distance, what the other one sees as well."""
    depth = float(np.median([board.pose.translation[2] for board in state.boards]))
    ahead = float(np.median([(state.pose @ board.pose).translation[2] for board in state.boards]))
    there = state.pose @ points_along(state.camera, pixels[0], depth)
    back = state.pose.undo(points_along(state.projector, pixels[1], ahead))
    return is_seen(state.projector, there, sizes[1]), is_seen(state.camera, back, sizes[0])


def _grid(size: Size) -> Floats:
    columns, rows = (np.linspace(0, side - 1, _GRID) for side in size)
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


def _lens_sigmas(device: Floats, pixels: Floats, covariance: Floats, in_view: Bools) -> Floats:
    sigmas: Floats = np.full(len(pixels), np.nan)
    by_turn, by_device = project_rays(device, rays_of(device, pixels[in_view]))
    if in_view.any():
        turns = by_turn.reshape(-1, 3)
        own = by_device.reshape(len(turns), -1)
        jacobian = (own - turns @ np.linalg.lstsq(turns, own, rcond=None)[0]).reshape(by_device.shape)
        sigmas[in_view] = np.sqrt(np.einsum("nka,ab,nkb->n", jacobian, covariance, jacobian) / 2)
    return sigmas.reshape(_GRID, _GRID)


def straightness(estimate: Estimate) -> float:
    """By what factor the focals' sigmas are larger than the curvature says: 1 where the cost is nearly a parabola.

    A valley that flattens out is wider than its floor is curved.
    """
    factor = 1.0
    free = estimate.prior.sigma > 0
    for column in (CAMERA.start, PROJECTOR.start):
        sigma = float(np.sqrt(estimate.covariance[column, column]))
        problem = board_problem(estimate.views, estimate.prior.knowing([column]), estimate.levels)
        for side in (-1.0, 1.0):
            step = np.zeros(estimate.state.size)
            step[column] = side * _WALK_SIGMAS * sigma
            response = np.where(free, estimate.covariance[:, column] / estimate.covariance[column, column], 0.0)
            step[:SHARED] = response * step[column]
            fit = problem.minimise(estimate.state.moved(step), tolerance=0.01)
            rise = max(fit.cost - estimate.fit.cost, 1e-3)
            factor = max(factor, _WALK_SIGMAS / float(np.sqrt(rise)))
    return factor if factor > _NEARLY_PARABOLIC else 1.0


def _focals(fit: BoardFit) -> str:
    return f"a camera of {fit.state.camera[0]:.0f} px with a projector of {fit.state.projector[0]:.0f} px"


def _because(coverage: BoardCoverage | None) -> str:
    reasons = coverage.reasons if coverage else []
    return f": {'; '.join(reasons)}." if reasons else "."
