"""Matches on three faces → a calibration with its uncertainty, or a refusal with a reason."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from calib.closed_form import objective_for
from calib.diagnostics import (
    ContradictionError,
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
from calib.estimation import Cells, Shift, Shifts, into_cells
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import PER_POSE, Calibration, Matches, TooFewMatchesError, before_the_matches
from calib.numerics import Floats, Ints, singular_refused
from calib.refinement import (
    CAMERA,
    ORDINARY_LENSES,
    SHARED,
    Family,
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
from calib.self_calibration.paper_method import calibrate_by_paper
from calib.self_calibration.result import Method, Profile, SelfCalibration, sweep_trials

_KNOWN_TRIALS, _AROUND_KNOWN, _AROUND_SIGMAS = 5, 0.05, 5.0  # camera focals, where other data determine it

WITH_BOARDS = FindingKind(
    "with-boards",
    "Calibrated together with boards of the same rig, with which the captures agree.",
    data=("cost", "limit"),
)


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
            return calibrate_by_paper(objective_for(matches, principal_point.px), matches, camera_size, projector_size)
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
    cells, families, is_turned = _numbered_alike([into_cells(matches) for matches in plain], knowledge)
    refuse_degenerate(cells, [family.straightened for family in families], RIG)
    trials = sweep_trials(knowledge.camera_size) if known is None else _trials_around(known)
    further = None if planes is None else lambda cells, state: with_further_planes(cells, plain, planes, state)
    refinement = refine(cells, families, trials, knowledge, same=same, further=further)
    if refinement is None:
        raise no_corner(cells, RIG)
    by_curvature = refinement.covariance
    refinement, _ = _with_shifts(
        _with_smooth_errors(refinement, shifts), [of_capture.decoding for of_capture in shifts]
    )
    at_rest_percent = percent_of_intrinsics(refinement.fit.state, np.sqrt(np.diag(refinement.covariance)))
    refinement, likely_percent = _with_shifts(refinement, [of_capture.likely for of_capture in shifts])
    findings: tuple[Finding, ...] = ()
    if known is not None:
        findings = (_on_known(*refuse_contradiction(refinement, known.rig, refinement.covariance - by_curvature)),)
    refuse_untrustworthy(refinement, knowledge)
    refinement, possible_percent = _with_shifts(refinement, [of_capture.possible for of_capture in shifts])
    next_view = best_next_view(refinement, knowledge)
    sameness = refinement.sameness if refinement.sameness and refinement.sameness.same else None
    calibrated = partial(
        SelfCalibration,
        profile=Profile(refinement.valley.focal_px, refinement.valley.posterior_cost),
        method="refined",
        findings=findings + findings_on_solution(refinement, knowledge, next_view),
        order_nats=max(0.0, sameness.lead) / 2 if sameness else 0.0,
        at_rest_percent=at_rest_percent,
        likely_percent=likely_percent,
        possible_percent=possible_percent,
        known=known,
        next_view=next_view,
        corners_covariance=refinement.covariance[np.ix_(*[_columns_of_corners(refinement.fit.state)] * 2)],
    )
    calibration, uncertainty = _calibration_of(refinement, knowledge, known), _uncertainty_of(refinement, known)
    results = []
    for number, matches in enumerate(captures):
        if len(captures) > 1:
            matches = _renumbered(matches, reflect=is_turned[number], shift=sameness.shifts[number] if sameness else 0)
        corner, residual_px = before_the_matches(refinement.corner(number), calibration, matches)
        own = replace(uncertainty, match_px=refinement.noise[number].match_px)
        results.append(calibrated(calibration, matches, corner, residual_px=residual_px, uncertainty=own))
    return tuple(results)


def _numbered_alike(cells: Sequence[Cells], knowledge: Knowledge) -> tuple[list[Cells], list[Family], list[bool]]:
    """Return the cells of captures, with faces 1 and 2 exchanged where they run the other way around the vertex; the
    family of closed-form solutions of each; and which were exchanged. A single capture stays as it is.
    """
    families = [family_of(of_capture, knowledge) for of_capture in cells]
    if len(cells) == 1:
        return [*cells], families, [False]
    vertices = [family.objective.camera_image.vertex for family in families]
    is_turned = [is_anticlockwise(of_capture, vertex) for of_capture, vertex in zip(cells, vertices, strict=True)]
    alike = [reflected(of_capture) if turn else of_capture for of_capture, turn in zip(cells, is_turned, strict=True)]
    return alike, [family_of(of_capture, knowledge) for of_capture in alike], is_turned


def _calibration_of(refinement: Refinement, knowledge: Knowledge, known: KnownCalibration | None) -> Calibration:
    state = refinement.fit.state
    sigmas = sigmas_of(state, refinement.covariance)
    calibration = calibration_of(state, knowledge.camera_size, knowledge.projector_size, sigmas)
    return calibration if known is None else known.with_own_pixels(calibration)


def _uncertainty_of(refinement: Refinement, known: KnownCalibration | None) -> Uncertainty:
    """Return the uncertainty of the rig, with the noise of the first capture."""
    fit, along = refinement.fit, along_valley(*refinement.valley.along(refinement.fit))
    noise_px = refinement.noise[0].match_px
    uncertainty = uncertainty_of(fit.state, refinement.covariance, fit.information, refinement.prior, noise_px, along)
    if known is None:
        return uncertainty
    return replace(uncertainty, with_log_baseline=known.with_log_baseline(refinement.covariance))


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
