"""Photos of one corner by one unchanged camera → its intrinsics, or a refusal with a reason (the paper's section 5.3).

The model is a rig whose two devices are the same camera (`State.one_camera`). The likelihood, its profile along the
focal length, the lens terms, the covariance and the refusals are those of a rig. Two things differ: the starting
values, and that the principal point may be unknown, because two photos give ten measurements for eight unknowns.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from calib.diagnostics import (
    calibration_of,
    findings_on_solution,
    no_corner,
    refuse_degenerate,
    refuse_untrustworthy,
    sigmas_of,
    uncertainty_of,
)
from calib.estimation import Cells, into_cells
from calib.geometry import PER_POSE, Corner, Matches, Pose, TooFewMatchesError, before_the_matches, unproject
from calib.numerics import Floats, Ints, singular_refused
from calib.refinement import (
    ORDINARY_LENSES,
    PER_CORNER,
    SHARED,
    CornerFit,
    CornerProblem,
    Knowledge,
    LensPrior,
    PrincipalPoint,
    Refinement,
    State,
    explore,
    minima,
    oriented,
    photo_family,
    settle,
    sweep_one,
    thin,
    twins,
)
from calib.refusal import PHOTOS, TOO_FEW_MATCHES, RefusalError
from calib.self_calibration.result import Profile, SelfCalibration, sweep_trials

# A photo may be a crop: its principal point may be anywhere in it.
_CROP_SIGMA_OF_WIDTH = 0.2
_HIDDEN = 16  # fits of the sweep that are refined in addition to its minima


def anywhere(size: tuple[int, int]) -> PrincipalPoint:
    """Return the prior on the principal point of a photo (width, height) that may have been cropped."""
    width, height = size
    return PrincipalPoint(((width - 1) / 2, (height - 1) / 2), _CROP_SIGMA_OF_WIDTH * width)


@singular_refused(PHOTOS)
def calibrate_photos(
    pairs: Sequence[Matches],
    size: tuple[int, int],
    *,
    principal_point: PrincipalPoint | None = None,
    squareness_deg: float | None = None,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
    focal_px: tuple[float, float] | None = None,
) -> tuple[SelfCalibration, ...]:
    """Calibrate the camera of photos of (width, height) from the matches of the first with each of the others.

    `pairs`: with faces 0, 1, 2 of one corner, `camera_px` in the first photo and `projector_px` in the other one.
    `principal_point`: `anywhere` by default. `squareness_deg`: see `self_calibrate`. `lenses`: the prior on the
    camera's lens, given twice. `focal_px`: a prior on the focal length, as mean and standard deviation. Returns one
    solution for each pair, in units of that pair's baseline; both of its devices are the camera.

    Raises RefusalError if the matches determine no trustworthy calibration.
    """
    point = principal_point or anywhere(size)
    knowledge = Knowledge(size, size, point.px, point.sigma_px, 0.0, True, focal_px, lenses=lenses).with_squareness(
        squareness_deg
    )
    try:
        cells = [into_cells(matches) for matches in pairs]
        families = [photo_family(cells_of_pair, knowledge) for cells_of_pair in cells]
    except TooFewMatchesError as error:
        raise RefusalError(
            TOO_FEW_MATCHES, f"The corner's faces hold too few matches: {error}.", PHOTOS.move
        ) from error
    refuse_degenerate(cells, [family.straightened for family in families], PHOTOS)
    thinned = [thin(cells_of_pair) for cells_of_pair in cells]
    sweep = sweep_one(thinned[0], families[0], sweep_trials(size), knowledge)
    starts = minima(sweep)
    if starts:
        # A correct valley narrower than the spacing of the trials costs more than a broad wrong one at every trial.
        hidden = [fit for at in sweep if at for fit in twins(thinned[0], families[0], at, knowledge)]
        starts += sorted(hidden, key=lambda fit: fit.cost)[:_HIDDEN]
        level = max(float(np.mean(starts[0].residuals[0] ** 2)), 1e-12)
        starts = sorted((_with_all(thinned, fit, knowledge, level) for fit in starts), key=lambda fit: fit.cost)
        fits = [oriented(thinned[:1], fit) for fit in explore(thinned, starts, knowledge)]
        refinement = settle(cells, fits, knowledge)
    if not starts or refinement is None:
        raise no_corner(cells, PHOTOS)
    refuse_untrustworthy(refinement, knowledge)
    return _solutions(refinement, knowledge, pairs)


def _solutions(refinement: Refinement, knowledge: Knowledge, pairs: Sequence[Matches]) -> tuple[SelfCalibration, ...]:
    state, findings = refinement.fit.state, findings_on_solution(refinement, knowledge)
    profile = Profile(refinement.valley.focal_px, refinement.valley.posterior_cost)
    solutions = []
    for i, matches in enumerate(pairs):
        alone, covariance = _one_pair(refinement, i)
        sigmas = sigmas_of(alone, covariance)
        calibration = calibration_of(alone, knowledge.camera_size, knowledge.camera_size, sigmas)
        corner, residual_px = before_the_matches(Corner(alone.corners[0].vertex, alone.legs(0)), calibration, matches)
        columns = _columns_of_pair(state, i)
        information = refinement.fit.information[np.ix_(columns, columns)]
        prior = knowledge.prior(alone)
        uncertainty = uncertainty_of(alone, covariance, information, prior, refinement.noise[i].match_px)
        solutions.append(
            SelfCalibration(calibration, matches, corner, profile, residual_px, "refined", findings, uncertainty)
        )
    return tuple(solutions)


def _one_pair(refinement: Refinement, pair: int) -> tuple[State, Floats]:
    """Return the two-photo state of one pair, in units of its own baseline, with its covariance."""
    state = refinement.fit.state
    pose, corner = state.pose_of(pair), state.corners[0]
    alone = replace(
        state,
        pose=pose.in_baselines,
        corners=(replace(corner, vertex=corner.vertex / pose.distance),),
        further=(),
    )
    columns = _columns_of_pair(state, pair)
    return alone, refinement.covariance[np.ix_(columns, columns)]


def _columns_of_pair(state: State, pair: int) -> Ints:
    """Return the columns of the joint state that correspond to a pair's own; a further photo's distance has none."""
    return state.columns(pair)[: SHARED + PER_CORNER + PER_POSE]


def _with_all(pairs: Sequence[Cells], fit: CornerFit, knowledge: Knowledge, variance: float) -> CornerFit:
    """Extend a fit of the first pair by the poses of all further photos, resected from its points."""
    state = replace(fit.state, further=tuple(_placed(cells, fit.state) for cells in pairs[1:]))
    variances = [np.full(len(cells), variance) for cells in pairs]
    return CornerProblem.of(pairs, knowledge.prior(state), variances).evaluate(state)


def _placed(cells: Cells, state: State) -> Pose:
    """Estimate the pose of a further photo from its matches with the first and the planes they lie on."""
    points = state.points(cells.camera_px, cells.plane)
    rays, _ = unproject(state.camera, cells.projector_px)
    placed, rotation, translation = cv2.solvePnP(
        points, np.ascontiguousarray(rays[:, :2]), np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
    )
    if not placed:
        return state.pose
    return Pose.from_vector(np.concatenate([rotation, translation]).astype(np.float64).ravel())
