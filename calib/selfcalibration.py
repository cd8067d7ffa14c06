"""Matches on three faces → a calibration with its uncertainty, or a refusal with a reason."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.arrays import Floats
from calib.calibration import Calibration
from calib.camera import Intrinsics
from calib.cells import MEDIAN_LENGTH, Cells, into_cells
from calib.corner import Corner
from calib.homography import TooFewMatchesError
from calib.matches import Matches
from calib.model import CAMERA, PROJECTOR, ROTATION, SQUARENESS, TRANSLATION
from calib.paper import Objective, objective_for, search
from calib.refine import Fit, Knowledge, Refinement, refine
from calib.refusal import RefusalError

Method = Literal["refined", "paper"]

# Trial focals, in units of the longer side of the camera's image: from a 120° to a 14° field of view.
_SHORTEST, _LONGEST = 0.3, 4.0
_PAPER_TRIALS, _SWEEP_TRIALS = 400, 36

_USEFUL_SIGMA = 0.2  # of a focal length
_CLEARLY_WORSE = 9.0  # in cost, that is three sigmas
_TENSION_SIGMAS = 4.0
_PLAUSIBLE_FOCAL = (0.2, 10.0)  # in projector widths
_CLOSED_CYCLE = 0.1  # paper's objective, in camera focals

_MOVE = "Move the rig so that all three faces are seen large and at different slants by both devices, and scan again."


@dataclass(frozen=True)
class PrincipalPoint:
    """What is known of the camera's principal point: `px` (x, y) with a standard deviation; 0 means exactly."""

    px: tuple[float, float]
    sigma_px: float


@dataclass(frozen=True)
class Profile:
    """The curve over the camera's focal length that was searched: `focal_px`, `cost` (n,); what `cost` is in words."""

    focal_px: Floats
    cost: Floats
    cost_name: str


@dataclass(frozen=True)
class SelfCalibration:
    """A calibration found from the corner alone, in units of the baseline (|t| = 1).

    `matches` are labelled with their faces, `corner` is in the camera's frame, `residual_px` is the root mean square
    reprojection error of a match in the projector, `notes` are things that a person should know.
    """

    calibration: Calibration
    matches: Matches
    corner: Corner
    profile: Profile
    residual_px: float
    method: Method
    notes: tuple[str, ...] = ()


def self_calibrate(
    matches: Matches,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    *,
    principal_point: PrincipalPoint,
    method: Method = "refined",
    squareness_deg: float = 0.3,
) -> SelfCalibration:
    """Calibrate both devices from matches labelled with the corner's faces 0, 1, 2.

    `method` 'paper' is the published one-dimensional search: it takes the principal point as exact and the corner as
    square and knows no sigma. 'refined' is the maximum-likelihood solution with lens terms; `squareness_deg` is the
    standard deviation of the angles between the faces around 90° (0: exactly square).

    Raises RefusalError where no trustworthy answer can be had.
    """
    try:
        if method == "paper":
            return _by_paper(objective_for(matches, principal_point.px), matches, camera_size, projector_size)
        knowledge = Knowledge(camera_size, projector_size, principal_point.px, principal_point.sigma_px, squareness_deg)
        return _by_refinement(into_cells(matches), matches, knowledge)
    except TooFewMatchesError as error:
        raise RefusalError(f"The corner's faces hold too few matches: {error}.", _MOVE) from error


def _trials(camera_size: tuple[int, int], count: int) -> Floats:
    trials: Floats = np.geomspace(_SHORTEST * max(camera_size), _LONGEST * max(camera_size), count)
    return trials


def _no_corner() -> RefusalError:
    return RefusalError(
        "These three faces are not the picture of a square corner for any focal length of the camera.",
        "A face may be wrong, or pass through one of the devices. " + _MOVE,
    )


def _by_paper(
    objective: Objective,
    matches: Matches,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
) -> SelfCalibration:
    solution = search(objective, _trials(camera_size, _PAPER_TRIALS))
    if solution is None:
        raise _no_corner()
    low, high = solution.focal_px[1], solution.focal_px[-2]
    if not low < solution.best_focal_px < high:
        raise RefusalError(
            f"The objective has no minimum for camera focal lengths between {low:.0f} and {high:.0f} px.", _MOVE
        )
    lowest = float(np.min(solution.objective))
    if lowest > _CLOSED_CYCLE * solution.best_focal_px:
        raise RefusalError(
            f"The transfer between the devices does not close: the objective's minimum is {lowest:.0f} px.", _MOVE
        )
    best = solution.best
    baseline = float(np.linalg.norm(best.translation[0]))
    matrix = best.matrix[0]
    calibration = Calibration(
        Intrinsics(*camera_size, (solution.best_focal_px,) * 2, objective.principal_point_px),
        Intrinsics(
            *projector_size,
            (float(matrix[0, 0]), float(matrix[1, 1])),
            (float(matrix[0, 2]), float(matrix[1, 2])),
        ),
        best.rotation[0],
        best.translation[0] / baseline,
    )
    corner, residual_px = _before_the_matches(Corner(best.vertex[0] / baseline, best.normals[0]), calibration, matches)
    return SelfCalibration(
        calibration,
        matches,
        corner,
        Profile(solution.focal_px, solution.objective, "objective E (px)"),
        residual_px,
        "paper",
        (
            "The paper's method knows neither lens distortion nor uncertainty: in simulated rooms it errs by 0.2 to "
            "16 %. It is there for comparison; 'method: refined' is the one to use.",
        ),
    )


def _by_refinement(cells: Cells, matches: Matches, knowledge: Knowledge) -> SelfCalibration:
    objective = objective_for(cells.as_matches(), knowledge.principal_point_px)
    refinement = refine(cells, objective, _trials(knowledge.camera_size, _SWEEP_TRIALS), knowledge)
    if refinement is None:
        raise _no_corner()
    _refuse_untrustworthy(refinement, knowledge)
    fit = refinement.fit
    calibration = Calibration(
        _intrinsics(knowledge.camera_size, fit.state.camera),
        _intrinsics(knowledge.projector_size, fit.state.projector),
        fit.state.rotation,
        fit.state.translation,
        sigma=_sigmas(refinement),
    )
    corner, residual_px = _before_the_matches(refinement.corner, calibration, matches)
    return SelfCalibration(
        calibration,
        matches,
        corner,
        Profile(refinement.profile_focal_px, refinement.profile_cost, "−2 log likelihood above the best"),
        residual_px,
        "refined",
        _notes(refinement, cells.rejected, knowledge.squareness_deg),
    )


def _intrinsics(size: tuple[int, int], device: Floats) -> Intrinsics:
    focal, x0, y0, k1, k2 = (float(value) for value in device)
    return Intrinsics(*size, (focal, focal), (x0, y0), (k1, k2, 0.0, 0.0, 0.0))


def _sigmas(refinement: Refinement) -> dict[str, float | tuple[float, ...]]:
    """Standard deviations by their names in a calibration file; angles in degrees."""
    state = refinement.fit.state
    sigma = np.sqrt(np.diag(refinement.covariance))
    sigmas: dict[str, float | tuple[float, ...]] = {}
    for name, device, columns in (("camera", state.camera, CAMERA), ("projector", state.projector, PROJECTOR)):
        focal, x0, y0, k1, k2 = (float(value) for value in sigma[columns])
        sigmas[f"{name}_focal_px"] = float(device[0]) * focal
        sigmas[f"{name}_principal_point_px"] = (x0, y0)
        sigmas[f"{name}_distortion"] = (k1, k2)
    sigmas["rotation_deg"] = tuple(float(value) for value in np.degrees(sigma[ROTATION]))
    sigmas["translation_direction_deg"] = float(np.degrees(np.hypot(*sigma[TRANSLATION])))
    sigmas["corner_angles_deg"] = tuple(float(value) for value in np.degrees(sigma[SQUARENESS]))
    return sigmas


def _refuse_untrustworthy(refinement: Refinement, knowledge: Knowledge) -> None:
    fit = refinement.fit
    sigma = np.sqrt(np.diag(refinement.covariance))
    relative = {"camera": float(sigma[CAMERA.start]), "projector": float(sigma[PROJECTOR.start])}
    for device, value in relative.items():
        if not value < _USEFUL_SIGMA:
            raise RefusalError(
                f"This view hardly determines the {device}'s focal length: its sigma is {100 * value:.0f} %.",
                _MOVE + " A principal point that is known, or a corner that is known to be square, also helps.",
            )
    _refuse_ambiguous(fit, refinement.others, relative["camera"])
    field = float(fit.state.projector[0]) / knowledge.projector_size[0]
    if not _PLAUSIBLE_FOCAL[0] < field < _PLAUSIBLE_FOCAL[1]:
        raise RefusalError(
            f"The solution has a projector whose focal length is {field:.2g} times its width, which no projector has.",
            "The faces may not be square to each other, or frames and patterns do not belong together. " + _MOVE,
        )
    off = np.degrees(fit.state.off_square)
    if np.linalg.norm(off) > _TENSION_SIGMAS * knowledge.squareness_deg > 0:
        raise RefusalError(
            f"The faces are not square to each other: they seem to be off by {_signed(off)} degrees, where "
            f"{knowledge.squareness_deg:g} was expected.",
            "Choose another corner, or give a larger corner.squareness_deg.",
        )


def _refuse_ambiguous(best: Fit, others: tuple[Fit, ...], relative_sigma: float) -> None:
    for other in others:
        apart = abs(np.log(other.state.camera[0] / best.state.camera[0]))
        if other.cost - best.cost < _CLEARLY_WORSE and apart > 2 * relative_sigma:
            raise RefusalError(
                f"Ambiguous: a camera focal length of {best.state.camera[0]:.0f} px and one of "
                f"{other.state.camera[0]:.0f} px explain this capture almost equally well.",
                "Capture the same corner again from another place with the rig unchanged.",
            )


def _notes(refinement: Refinement, rejected: float, squareness_deg: float) -> tuple[str, ...]:
    notes = []
    if squareness_deg == 0:
        notes.append(
            "The corner was taken as exactly square: 0.1 degrees off would move the focals by 1 to 3 %, "
            "which the sigmas do not contain."
        )
    else:
        notes.append(
            f"The faces were allowed to be off square by {squareness_deg:g} degrees (1 sigma); they seem to be off by "
            f"{_signed(np.degrees(refinement.fit.state.off_square))} degrees."
        )
    if refinement.systematic_px > 0:
        notes.append(
            f"Beyond independent noise, {refinement.systematic_px:.3f} px stay unexplained in the mean of a cell of "
            f"matches, alike in neighbouring ones; the sigmas contain it (× {np.sqrt(refinement.inflation):.1f})."
        )
    if rejected > 0.01:
        notes.append(f"{100 * rejected:.1f} % of the matches on the faces were left out as outliers.")
    return tuple(notes)


def _signed(values: Floats) -> str:
    return ", ".join(f"{value:+.2f}" for value in values)


def _before_the_matches(corner: Corner, calibration: Calibration, matches: Matches) -> tuple[Corner, float]:
    """The corner with its legs pointing along its faces, and the reprojection error of the matches on them."""
    assert matches.face is not None
    labelled = matches[matches.face >= 0]
    points = _on_faces(corner, calibration.camera, labelled)
    return _towards(corner, points), _reprojection_error(calibration, points, labelled)


def _on_faces(corner: Corner, camera: Intrinsics, labelled: Matches) -> Floats:
    """Where the camera's rays of labelled matches meet their faces, (N, 3) in the camera's frame."""
    normals = corner.normals[labelled.face]
    rays = camera.unproject(labelled.camera_px)
    points: Floats = (normals @ corner.vertex / np.sum(normals * rays, axis=1))[:, None] * rays
    return points


def _towards(corner: Corner, points: Floats) -> Corner:
    """The corner with each leg on the side of the vertex on which the points (N, 3) of its faces are."""
    # Coordinates along the legs; a point on face S has two, the third being zero.
    coordinates = np.linalg.solve(corner.legs.T, (points - corner.vertex).T)
    signs = np.sign(np.nanmedian(np.where(np.abs(coordinates) > 1e-9, coordinates, np.nan), axis=1))
    return Corner(corner.vertex, corner.legs * signs[:, None])


def _reprojection_error(calibration: Calibration, points: Floats, labelled: Matches) -> float:
    """Root mean square distance in the projector between matches and their points (N, 3); robust.

    The median length is scaled to the root mean square of a 2-D normal deviate, so that outliers do not count.
    """
    predicted = calibration.projector.project(points @ calibration.rotation.T + calibration.translation)
    error = np.linalg.norm(predicted - labelled.projector_px, axis=1)
    return float(np.nanmedian(error) * np.sqrt(2) / MEDIAN_LENGTH)
