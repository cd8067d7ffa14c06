"""Matches on three faces → a calibration with its uncertainty, or a refusal with a reason."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.closed_form import Objective, objective_for, search
from calib.diagnostics import (
    ContradictionError,
    NextView,
    Uncertainty,
    along_valley,
    best_next_view,
    calibration_of,
    findings_on_solution,
    no_corner,
    refuse_changed_rig,
    refuse_contradiction,
    refuse_degenerate,
    refuse_untrustworthy,
    sigmas_of,
    uncertainty_of,
)
from calib.estimation import Shift, Shifts, into_cells
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import (
    PER_POSE,
    Calibration,
    Corner,
    Intrinsics,
    Matches,
    Pose,
    TooFewMatchesError,
    before_the_matches,
)
from calib.numerics import Floats, Ints, singular_refused
from calib.refinement import (
    CAMERA,
    ORDINARY_LENSES,
    SHARED,
    Knowledge,
    LensPrior,
    PrincipalPoint,
    Refinement,
    State,
    covariance_of_smooth_errors,
    family_of,
    is_anticlockwise,
    percent_of_intrinsics,
    refine,
    reflected,
    response_to_shift,
    together,
    with_further_planes,
)
from calib.refusal import RIG, TOO_FEW_MATCHES, RefusalError
from calib.self_calibration.known_calibration import KnownCalibration

Method = Literal["refined", "paper"]

# Trial focals, in units of the longer side of the camera's image: from a 120° to a 14° field of view.
_SHORTEST, _LONGEST = 0.3, 4.0
_PAPER_TRIALS, _SWEEP_TRIALS = 64, 24
_KNOWN_TRIALS, _AROUND_KNOWN, _AROUND_SIGMAS = 5, 0.05, 5.0  # camera focals, where other data determine it

_CLOSED_CYCLE = 0.1  # paper's objective, in camera focals

PAPER_METHOD = FindingKind(
    "paper-method",
    "The paper's method models neither lens distortion nor uncertainty; it is meant for comparison.",
    "Use 'method: refined'.",
)
PAPER_FAILED = FindingKind(
    "paper-failed",
    "The paper's objective has no minimum, or its transfer between the devices does not close.",
    "Use 'method: refined', or show all three faces large and at different slants to both devices.",
)
WITH_BOARDS = FindingKind(
    "with-boards",
    "Calibrated together with boards of the same rig, with which the captures agree.",
    data=("cost", "limit"),
)


@dataclass(frozen=True)
class Profile:
    """The curve searched over the camera's focal length: `focal_px` and `cost` (n,)."""

    focal_px: Floats
    cost: Floats


@dataclass(frozen=True)
class SelfCalibration:
    """A calibration found from the corner alone, in units of the baseline (|t| = 1).

    `matches` are labelled with their faces, `corner` is in the camera's frame, `residual_px` is the root mean square
    reprojection error of a match in the projector, `findings` are for the user. `uncertainty` is None for a
    method that estimates none. `order_nats`: for captures of one corner, the log likelihood ratio between the numbering
    of the faces and the next best one, given the corner's angles; 0 where the angles do not distinguish them.
    Standard deviations of the intrinsics: `at_rest_percent` without shifts of the matches, `likely_percent` from
    likely shifts alone, `possible_percent` from undetectable shifts; all are part of the sigmas. `known`: the
    calibration it was combined with, if any. `next_view`: where another capture would help most; None if no view sees
    the corner or the method does not compute it. `corners_covariance` (21 + 6 n, 21 + 6 n): of the calibration's
    columns and, for each of n captures, of the rotation of its corner about the camera's axes and the shift of its
    vertex as a share of its distance.
    """

    calibration: Calibration
    matches: Matches
    corner: Corner
    profile: Profile
    residual_px: float
    method: Method
    findings: tuple[Finding, ...] = ()
    uncertainty: Uncertainty | None = None
    order_nats: float = 0.0
    at_rest_percent: float = 0.0
    likely_percent: float = 0.0
    possible_percent: float = 0.0
    known: KnownCalibration | None = None
    next_view: NextView | None = None
    corners_covariance: Floats | None = None

    @property
    def metric(self) -> Calibration:
        """The calibration in the unit of the known calibration; in baselines if there is none or it has no unit."""
        if self.known is None or self.uncertainty is None:
            return self.calibration
        return self.known.metric(self.calibration, self.uncertainty)


def _columns_of_corners(state: State) -> Ints:
    """The columns of the calibration, and of each capture's corner without its further planes."""
    starts = [state.corner_columns(i).start for i in range(len(state.corners))]
    return np.concatenate([np.arange(SHARED), *(np.arange(start, start + PER_POSE) for start in starts)])


@singular_refused(RIG)
def self_calibrate(
    matches: Matches,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    *,
    principal_point: PrincipalPoint,
    method: Method = "refined",
    squareness_deg: float | None = None,
    decentering: float | None = None,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
    plane: Ints | None = None,
    shifts: Shifts | None = None,
) -> SelfCalibration:
    """Calibrate both devices from matches labelled with the corner's faces 0, 1, 2.

    `method` 'paper' is the published one-dimensional search: it takes the principal point as exact and the corner as
    square and estimates no sigma. 'refined' is the maximum-likelihood solution with lens terms; `squareness_deg` is the
    standard deviation of the angles between the faces around 90° (0: exactly square; None: nothing is said, they are
    those of one of the populations of walls). `plane` (N,): the plane of each
    match. `shifts`, `decentering` and `lenses`: see `self_calibrate_jointly`.

    Raises RefusalError if the matches determine no trustworthy calibration.
    """
    if method == "paper":
        try:
            return _by_paper(objective_for(matches, principal_point.px), matches, camera_size, projector_size)
        except TooFewMatchesError as error:
            raise _too_few(error) from error
    (calibrated,) = self_calibrate_jointly(
        [matches],
        camera_size,
        projector_size,
        principal_point=principal_point,
        squareness_deg=squareness_deg,
        decentering=decentering,
        lenses=lenses,
        planes=None if plane is None else [plane],
        shifts=[] if shifts is None else [shifts],
    )
    return calibrated


@singular_refused(RIG)
def self_calibrate_jointly(
    captures: Sequence[Matches],
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    *,
    principal_point: PrincipalPoint,
    squareness_deg: float | None = None,
    decentering: float | None = None,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
    same: bool = True,
    planes: Sequence[Ints] | None = None,
    shifts: Sequence[Shifts] = (),
    known: KnownCalibration | None = None,
) -> tuple[SelfCalibration, ...]:
    """Calibrate one unchanged rig from several captures by maximum likelihood; return one result per capture.

    `planes`: for each capture, the plane of each match (N,), −1 for none, as in `Faces.plane`. Planes other than the
    faces that are parallel or perpendicular to them add constraints.

    `same`: assume that the captures show one corner and share its angles. This is tested, and dropped with a note if
    the matches contradict it. The faces of all results are numbered alike, so that their corners define one frame.

    `squareness_deg`: see `self_calibrate`. `lenses`: priors on the lenses of camera and projector, and on the
    projector's principal point. `decentering`: standard deviation of p1 and p2 to use instead of theirs (0: no
    decentring); by default, ordinary lenses are of one of several populations.

    `shifts`: for each capture, the possible systematic shifts of its matches; none by default.

    `known`: a calibration of the rig from other data, such as boards, combined with the captures. `principal_point`
    is then used only if it is exactly known.

    Raises RefusalError if the captures determine no trustworthy calibration or contradict `known`.
    """
    camera, projector = lenses
    knowledge = Knowledge(
        camera_size,
        projector_size,
        principal_point.px,
        principal_point.sigma_px,
        0.0,
        lenses=(camera.with_sigmas(decentering), projector.with_sigmas(decentering)),
    ).with_squareness(squareness_deg)
    if known is not None:
        knowledge = _knowing(knowledge, known)
    try:
        return _by_refinement(captures, knowledge, same=same, planes=planes, shifts=shifts, known=known)
    except TooFewMatchesError as error:
        raise _too_few(error) from error
    except RefusalError as refusal:
        if len(captures) > 1 and known is None:
            _blame_changed_rig(captures, knowledge, planes, shifts, refusal)
        raise


def _blame_changed_rig(
    captures: Sequence[Matches],
    knowledge: Knowledge,
    planes: Sequence[Ints] | None,
    shifts: Sequence[Shifts],
    refusal: RefusalError,
) -> None:
    """Raise ContradictionError from the refusal of all captures together if those that are fine alone are not of one
    rig.
    """
    alone: dict[int, Uncertainty] = {}
    for number, matches in enumerate(captures):
        own_planes, own_shifts = None if planes is None else [planes[number]], shifts[number : number + 1]
        try:
            (calibrated,) = _by_refinement(
                [matches], knowledge, same=True, planes=own_planes, shifts=own_shifts, known=None
            )
        except (RefusalError, TooFewMatchesError):
            continue
        if calibrated.uncertainty is not None:
            alone[number] = calibrated.uncertainty
    try:
        refuse_changed_rig(alone)
    except ContradictionError as contradiction:
        raise contradiction from refusal


def _knowing(knowledge: Knowledge, known: KnownCalibration) -> Knowledge:
    extended = replace(knowledge, rig=known.rig)
    if knowledge.principal_point_sigma_px == 0:
        return extended
    return replace(extended, principal_point_px=known.calibration.camera.principal_point_px)


def _too_few(error: TooFewMatchesError) -> RefusalError:
    return RefusalError(TOO_FEW_MATCHES, f"The corner's faces hold too few matches: {error}.", RIG.move)


def paper_trials(camera_size: tuple[int, int]) -> Floats:
    """The camera focals (n,) that the paper's search samples, for a camera of (width, height)."""
    return _trials(camera_size, _PAPER_TRIALS)


def sweep_trials(camera_size: tuple[int, int]) -> Floats:
    """The camera focals (n,) at which the refinement starts, for a camera of (width, height)."""
    return _trials(camera_size, _SWEEP_TRIALS)


def _trials(camera_size: tuple[int, int], count: int) -> Floats:
    return np.geomspace(_SHORTEST * max(camera_size), _LONGEST * max(camera_size), count)


def _by_paper(
    objective: Objective,
    matches: Matches,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
) -> SelfCalibration:
    solution = search(objective, paper_trials(camera_size))
    if solution is None:
        raise no_corner([into_cells(matches)], RIG)
    low, high = solution.focal_px[1], solution.focal_px[-2]
    if not low < solution.best_focal_px < high:
        raise RefusalError(
            PAPER_FAILED,
            f"The objective has no minimum for camera focal lengths between {low:.0f} and {high:.0f} px.",
            RIG.move,
        )
    lowest = float(np.min(solution.objective))
    if lowest > _CLOSED_CYCLE * solution.best_focal_px:
        raise RefusalError(
            PAPER_FAILED,
            f"The transfer between the devices does not close: the objective's minimum is {lowest:.0f} px.",
            RIG.move,
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
        Pose(best.rotation[0], best.translation[0] / baseline),
    )
    corner, residual_px = before_the_matches(Corner(best.vertex[0] / baseline, best.normals[0]), calibration, matches)
    return SelfCalibration(
        calibration,
        matches,
        corner,
        Profile(solution.focal_px, solution.objective),
        residual_px,
        "paper",
        (
            Finding(
                PAPER_METHOD,
                Severity.NOTE,
                "The paper's method models neither lens distortion nor uncertainty: with ordinary lenses its error is "
                "several per cent. It is meant for comparison; use the method 'refined' instead.",
            ),
        ),
    )


def _by_refinement(
    captures: Sequence[Matches],
    knowledge: Knowledge,
    *,
    same: bool,
    planes: Sequence[Ints] | None,
    shifts: Sequence[Shifts],
    known: KnownCalibration | None,
) -> tuple[SelfCalibration, ...]:
    plain = [known.with_square_pixels(matches) if known else matches for matches in captures]
    cells = [into_cells(matches) for matches in plain]
    families = [family_of(cells_of_capture, knowledge) for cells_of_capture in cells]
    if len(captures) > 1:
        vertices = [family.objective.camera_image.vertex for family in families]
        turned = [
            is_anticlockwise(cells_of_capture, vertex) for cells_of_capture, vertex in zip(cells, vertices, strict=True)
        ]
        cells = [
            reflected(cells_of_capture) if turn else cells_of_capture
            for cells_of_capture, turn in zip(cells, turned, strict=True)
        ]
        families = [family_of(cells_of_capture, knowledge) for cells_of_capture in cells]
    refuse_degenerate(cells, [family.straightened for family in families], RIG)
    trials = sweep_trials(knowledge.camera_size) if known is None else _trials_around(known)
    further = None if planes is None else lambda cells, state: with_further_planes(cells, plain, planes, state)
    refinement = refine(cells, families, trials, knowledge, same=same, further=further)
    if refinement is None:
        raise no_corner(cells, RIG)
    by_curvature = refinement.covariance
    refinement, _ = _with_shifts(
        _with_smooth_errors(refinement, shifts), [capture_shifts.decoding for capture_shifts in shifts]
    )
    at_rest_percent = percent_of_intrinsics(refinement.fit.state, np.sqrt(np.diag(refinement.covariance)))
    refinement, likely_percent = _with_shifts(refinement, [capture_shifts.likely for capture_shifts in shifts])
    findings: tuple[Finding, ...] = ()
    if known is not None:
        findings = (_on_known(*refuse_contradiction(refinement, known.rig, refinement.covariance - by_curvature)),)
    refuse_untrustworthy(refinement, knowledge)
    refinement, possible_percent = _with_shifts(refinement, [capture_shifts.possible for capture_shifts in shifts])
    fit = refinement.fit
    calibration = calibration_of(
        fit.state,
        knowledge.camera_size,
        knowledge.projector_size,
        sigmas_of(fit.state, refinement.covariance),
    )
    if known is not None:
        calibration = known.with_own_pixels(calibration)
    next_view = best_next_view(refinement, knowledge)
    findings += findings_on_solution(refinement, knowledge, next_view)
    profile = Profile(refinement.valley.focal_px, refinement.valley.posterior_cost)
    sameness = refinement.sameness
    order_nats = max(0.0, sameness.lead) / 2 if sameness and sameness.same else 0.0
    along = along_valley(*refinement.valley.along(fit))
    results = []
    for i, matches in enumerate(captures):
        if len(captures) > 1:
            shift = sameness.shifts[i] if sameness and sameness.same else 0
            matches = _renumbered(matches, reflect=turned[i], shift=shift)
        corner, residual_px = before_the_matches(refinement.corner(i), calibration, matches)
        uncertainty = uncertainty_of(
            fit.state, refinement.covariance, fit.information, refinement.prior, refinement.noise[i].match_px, along
        )
        if known is not None:
            with_log_baseline = known.with_log_baseline(refinement.covariance)
            uncertainty = replace(uncertainty, with_log_baseline=with_log_baseline)
        results.append(
            SelfCalibration(
                calibration,
                matches,
                corner,
                profile,
                residual_px,
                "refined",
                findings,
                uncertainty,
                order_nats,
                at_rest_percent,
                likely_percent,
                possible_percent,
                known,
                next_view,
                refinement.covariance[np.ix_(*[_columns_of_corners(fit.state)] * 2)],
            )
        )
    return tuple(results)


def _trials_around(known: KnownCalibration) -> Floats:
    focal = float(known.calibration.camera.focal_px[0])
    sigma = float(np.sqrt(known.uncertainty.covariance[CAMERA.start, CAMERA.start]))
    reach = max(_AROUND_KNOWN, _AROUND_SIGMAS * sigma)
    return focal * np.exp(np.linspace(-reach, reach, _KNOWN_TRIALS))


def _on_known(raised: float, limit: float) -> Finding:
    return Finding(
        WITH_BOARDS,
        Severity.NOTE,
        "Calibrated together with boards of the same rig. Captures and boards agree: combining them raises "
        f"−2 log likelihood by {raised:.0f}; chance explains up to {limit:.0f}.",
        data={"cost": raised, "limit": limit},
    )


def _with_shifts(refinement: Refinement, shifts: Sequence[Sequence[Shift]]) -> tuple[Refinement, float]:
    """Add independent shifts of each capture to the covariance; also return their effect in per cent."""
    state = refinement.fit.state
    responses = [response_to_shift(refinement, shift, capture) for capture, some in enumerate(shifts) for shift in some]
    covariance = together(responses, state.size)
    percent = percent_of_intrinsics(state, np.sqrt(np.diag(covariance)))
    return replace(refinement, covariance=refinement.covariance + covariance), percent


def _with_smooth_errors(refinement: Refinement, shifts: Sequence[Shifts]) -> Refinement:
    """Add the decoder's smooth errors over each plane to the covariance."""
    smooth = (
        covariance_of_smooth_errors(refinement, of_capture.smooth_px, capture)
        for capture, of_capture in enumerate(shifts)
        if of_capture.smooth_px
    )
    return replace(refinement, covariance=sum(smooth, refinement.covariance))


def _renumbered(matches: Matches, *, reflect: bool, shift: int) -> Matches:
    """Renumber the face labels as the refinement did."""
    face = matches.labels
    if reflect:
        face = np.where(face > 0, 3 - face, face)
    return matches.with_faces(np.where(face >= 0, (face + shift) % 3, face).astype(np.int32))
