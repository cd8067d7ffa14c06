"""Acceptance tests of a refined solution. An untrustworthy one is refused with its reason."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from calib.diagnostics.degeneracy import one_plane, reasons_in_images, reasons_in_space
from calib.diagnostics.next_best_view import best_next_view
from calib.estimation import Cells
from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats, covariance_of
from calib.refinement import (
    CAMERA,
    CLEARLY_WORSE,
    PROJECTOR,
    SHARED,
    TANGENTIAL_TERMS,
    CornerFit,
    Knowledge,
    PrincipalPoint,
    Refinement,
    Straightened,
    intrinsic_distance,
)
from calib.refusal import AMBIGUOUS, UNDETERMINED_FOCAL, RefusalError, Wording

USEFUL_SIGMA = 0.15  # of a focal length; beyond it no sigma describes the long, curved valley
_TENSION_SIGMAS = 4.0
CENTRED = 1e-4  # p1 and p2 of a lens that is hardly decentred: a twentieth of a pixel at the image's corner
_SIGNIFICANT = 0.9999
_SCALED = 0.05  # probability of a scaled picture that is worth a sentence
_MISFIT_PX, _MISFIT_OF_NOISE = 0.1, 0.3
_PLAUSIBLE_FOCALS = {"camera": (0.3, 4.0), "projector": (0.2, 10.0)}  # in image widths

FROM_ONE_PLACE = FindingKind(
    "from-one-place",
    "The rig was not moved between captures: their smooth errors are the same, so together they count as one.",
    "Move the rig between captures.",
    ("captures",),
)
PICTURE_SCALED = FindingKind(
    "picture-scaled",
    "The projector's picture may be scaled in one direction; the sigmas allow for it.",
    "Show the picture in the projector's own resolution, without keystone correction, zoom or overscan.",
    ("aspect_percent", "sigma_percent", "probability_share"),
)

NO_SQUARE_CORNER = FindingKind(
    "no-square-corner",
    "For no focal length are the three faces the picture of a square corner.",
    "Look at the coloured faces in the report. If they are wrong, draw them (--masks); otherwise show all three large "
    "and at different slants.",
)
ONE_PLANE = FindingKind(
    "faces-in-one-plane",
    "Faces of the supposed corner lie in one plane.",
    "Choose a corner with three planes, let light fall on all of them, and keep both devices well apart.",
    ("captures",),
)
IMPLAUSIBLE_FOCAL = FindingKind(
    "implausible-focal",
    "The solution has a focal length that no ordinary device has.",
    "The faces may not be square to each other, or frames and patterns do not belong together. Choose another view.",
    ("focal_widths",),
)
CORNER_MISFIT = FindingKind(
    "corner-misfit",
    "No corner explains the matches: a smooth misfit remains over the faces.",
    "Faces may be bent or wrong, or the lenses may have more distortion than the model allows for. Choose another "
    "corner, or calibrate the rig with a board.",
    ("captures", "misfit_px", "limit_px"),
)
NOT_SQUARE = FindingKind(
    "not-square",
    "The faces are less square to each other than corner.squareness_deg allows for.",
    "Choose another corner, or allow for more (0.5 or 1 in an old house). Check a principal point that was given as "
    "known, and the projector's keystone correction.",
    ("allowed_deg", "off_square_deg", "cost"),
)


def no_corner(captures: Sequence[Cells], words: Wording) -> RefusalError:
    """The refusal if no focal length makes the faces a square corner."""
    return RefusalError(
        NO_SQUARE_CORNER,
        "These three faces are not the picture of a square corner for any focal length of the camera"
        + _because([reason for cells in captures for reason in reasons_in_images(cells)]),
        "A face may be wrong, or be seen edge on. " + words.move + words.shape,
    )


def refuse_degenerate(captures: Sequence[Cells], straightened: Sequence[Straightened], words: Wording) -> None:
    """Raise RefusalError if two faces of a capture lie in one plane, within its noise."""
    for i, (cells, straight) in enumerate(zip(captures, straightened, strict=True)):
        of = f" of {words.taken} {i + 1}" if len(captures) > 1 else ""
        if reason := one_plane(cells, straight, words):
            raise RefusalError(
                ONE_PLANE,
                f"The faces{of} are not those of a corner: {reason}.",
                f"Choose a corner with three planes, and keep {words.both} well apart. " + words.move,
                {"captures": (i + 1,)},
            )


def refuse_untrustworthy(refinement: Refinement, knowledge: Knowledge) -> None:
    """Raise RefusalError if the solution is undetermined, ambiguous, or not that of a square corner."""
    fit, words = refinement.fit, knowledge.words
    sigma = np.sqrt(np.diag(refinement.covariance))
    relative = {"camera": float(sigma[CAMERA.start]), "projector": float(sigma[PROJECTOR.start])}
    for device, value in relative.items():
        if not value < USEFUL_SIGMA:
            raise RefusalError(
                UNDETERMINED_FOCAL,
                f"This view hardly determines the {device}'s focal length: its sigma is {100 * value:.0f} %"
                + _because(_reasons(refinement, words))
                + _if_centred(refinement),
                _sentences(*on_repeats(refinement), *on_picture_scale(refinement), _where_to_go(refinement, knowledge))
                + missing_knowledge(knowledge),
                {"sigma_percent": 100 * value},
            )
    centre = sigma[PROJECTOR][1:3] / fit.state.projector[0]
    alternatives = [fit for fit in refinement.others if not _absurd_focals(fit, knowledge)]
    _refuse_ambiguous(fit, alternatives, np.array([*relative.values(), *centre]), words)
    for name, field in _absurd_focals(fit, knowledge).items():
        raise RefusalError(
            IMPLAUSIBLE_FOCAL,
            f"The solution has a {name} with a focal length of {field:.2g} image widths, which is implausible"
            + _because(_reasons(refinement, words)),
            f"The faces may not be square to each other, or {words.unrelated}. " + words.move + words.shape,
            {"focal_widths": field},
        )
    _refuse_misfit(refinement, words)
    _refuse_skew(refinement, knowledge)


def _if_centred(refinement: Refinement) -> str:
    """A sentence on the sigma of the camera's focal length for centred lenses; empty if it is not much smaller."""
    fit, free = refinement.fit, refinement.prior.free
    sigma = sigma_if(refinement, dict.fromkeys(TANGENTIAL_TERMS, CENTRED))
    if sigma > 0.5 * np.sqrt(covariance_of(fit.information, free)[CAMERA.start, CAMERA.start]):
        return ""
    return f" It would be ± {100 * sigma:.2g} % for the camera if p1 and p2 of both lenses were below {CENTRED:g}."


def sigma_if(refinement: Refinement, known: Mapping[int, float]) -> float:
    """The relative sigma of the camera's focal length, by curvature, with added priors of these sigmas on columns."""
    information = refinement.fit.information.copy()
    for column, sigma in known.items():
        information[column, column] += sigma**-2.0
    return float(np.sqrt(covariance_of(information, refinement.prior.free)[CAMERA.start, CAMERA.start]))


def _absurd_focals(fit: CornerFit, knowledge: Knowledge) -> dict[str, float]:
    """The implausible focal lengths of a solution by device, in image widths."""
    absurd = {}
    for device, parameters, size in (
        ("camera", fit.state.camera, knowledge.camera_size),
        ("projector", fit.state.projector, knowledge.projector_size),
    ):
        low, high = _PLAUSIBLE_FOCALS[device]
        field = float(parameters[0]) / max(size)
        if not low < field < high:
            absurd[device] = field
    return absurd


def missing_knowledge(knowledge: Knowledge) -> str:
    """Advice on prior knowledge that was not given, as a sentence; empty if there is none."""
    unsaid = [
        what
        for what, sigma in (
            ("a principal point that is known", knowledge.principal_point_sigma_px),
            ("a corner that is known to be square", knowledge.squareness_deg),
        )
        if sigma
    ]
    if not unsaid:
        return ""
    sentence = ", or ".join(unsaid)
    return f" {sentence[0].upper()}{sentence[1:]}{',' if len(unsaid) > 1 else ''} also helps."


def on_repeats(refinement: Refinement) -> list[Finding]:
    """A note on each group of captures between which the rig was not moved."""
    state, count = refinement.fit.state, len(refinement.noise)
    if state.one_camera:
        return []
    groups = {tuple(j + 1 for j in range(count) if state.same_place(i, j)) for i in range(count)}
    return [
        Finding(
            FROM_ONE_PLACE,
            Severity.NOTE,
            f"Taken from the same place: captures {', '.join(map(str, group[:-1]))} and {group[-1]}. Their smooth "
            "errors are the same, so together they count as one.",
            FROM_ONE_PLACE.remedy,
            {"captures": group},
        )
        for group in sorted(groups)
        if len(group) > 1
    ]


def _where_to_go(refinement: Refinement, knowledge: Knowledge) -> str:
    if knowledge.one_camera:
        return f"{knowledge.words.move} {knowledge.words.again}"
    view = best_next_view(refinement, knowledge)
    if view is None or view.sigma > USEFUL_SIGMA:
        return knowledge.words.move
    return (
        f"Capture this corner again with the rig moved {view.words}, and calibrate from both captures: the camera's "
        f"focal length will then have a sigma of about {100 * view.sigma:.2g} %."
    )


def _refuse_misfit(refinement: Refinement, words: Wording) -> None:
    for i, noise in enumerate(refinement.noise):
        limit_px = _MISFIT_PX + _MISFIT_OF_NOISE * noise.match_px
        if noise.smooth_px > limit_px:
            which = f" of {words.taken} {i + 1}" if len(refinement.noise) > 1 else ""
            raise RefusalError(
                CORNER_MISFIT,
                f"No corner explains the matches{which}: {noise.smooth_px:.2g} {words.pixels} of smooth misfit remain "
                f"over the faces, where {words.smooth} leave less than {limit_px:.2g}.",
                "The faces may be bent or wrong, or the lenses may have more distortion than the model allows "
                "for. " + words.move + words.shape,
                {"captures": (i + 1,), "misfit_px": noise.smooth_px, "limit_px": limit_px},
            )


def _refuse_skew(refinement: Refinement, knowledge: Knowledge) -> None:
    worst = _skewest(refinement)
    if refinement.tension > float(scipy.special.chdtri(refinement.fit.state.off_square.size, 1 - _SIGNIFICANT)):
        angles = "" if knowledge.squareness_deg == 0 else f" (they seem to be off by {named_angles(worst)})"
        raise RefusalError(
            NOT_SQUARE,
            f"The faces are not square to each other{angles}, where "
            + (
                f"{allowed_deg(refinement):g} degrees were allowed for"
                if knowledge.squareness_deg
                else "they should be"
            )
            + f": with the angles free, −2 log likelihood is lower by {refinement.tension:.0f}.",
            _sentences(
                *on_picture_scale(refinement),
                "Choose another corner, or allow for walls farther from square (a larger squareness_deg).",
            )
            + _given_centre(knowledge)
            + knowledge.words.shape,
            {
                "allowed_deg": allowed_deg(refinement),
                "off_square_deg": float(np.abs(worst).max()),
                "cost": refinement.tension,
            },
        )


def _skewest(refinement: Refinement) -> Floats:
    """The angles off square, in degrees (3,), of the corner that is farthest from it."""
    off_square = np.degrees(refinement.fit.state.off_square)
    worst: Floats = off_square[np.argmax(np.linalg.norm(off_square, axis=1))]
    return worst


def allowed_deg(refinement: Refinement) -> float:
    """The standard deviation of the corners' angles in the solution's prior, in degrees."""
    return round(float(np.degrees(refinement.prior.sigma[SHARED])), 3)


def far_from_square(refinement: Refinement) -> bool:
    """Whether a corner is farther from square than the solution's prior expects; False for an exact corner."""
    expected_deg = float(np.degrees(refinement.prior.sigma[SHARED]))
    return bool(np.linalg.norm(_skewest(refinement)) > _TENSION_SIGMAS * expected_deg > 0)


def _given_centre(knowledge: Knowledge) -> str:
    """Advice to verify the principal points that were given as exact; empty without any."""
    camera = PrincipalPoint(knowledge.principal_point_px, knowledge.principal_point_sigma_px)
    projector = None if knowledge.one_camera else knowledge.lenses[1].point
    advice = ""
    for device, point, (width, height) in (
        ("camera", camera, knowledge.camera_size),
        ("projector", projector, knowledge.projector_size),
    ):
        if point is None or point.sigma_px > 0:
            continue
        x, y = point.px
        # A lens shift puts a projector's outside of its picture.
        inside = (0 <= x < width and 0 <= y < height) or device == "projector"
        place = "" if inside else f", outside of the image of {width} × {height} pixels"
        advice += f" Verify the {device}'s principal point, too: ({x:.0f}, {y:.0f}) was given as known{place}."
    return advice


def named_angles(off_deg: Floats) -> str:
    """By how much the angles (3,) between the faces are off, 'B–C +0.07°, …'; no sign before a rounded zero."""
    signed = (f"{value:+z.2f}°".replace("+0.00", "0.00").replace("-", "−") for value in off_deg)
    return ", ".join(f"{faces} {angle}" for faces, angle in zip(("B–C", "C–A", "A–B"), signed, strict=True))


def _refuse_ambiguous(best: CornerFit, alternatives: Sequence[CornerFit], sigmas: Floats, words: Wording) -> None:
    """Raise RefusalError for a second likely minimum. `sigmas` (4,): in the units of `intrinsic_distance`."""
    for alternative in alternatives:
        apart = intrinsic_distance(alternative.state, best.state)
        if alternative.cost - best.cost < CLEARLY_WORSE and np.any(apart > 2 * sigmas):
            raise RefusalError(
                AMBIGUOUS,
                f"Ambiguous: {_intrinsics(best)}, and {_intrinsics(alternative)}, explain this {words.taken} almost "
                "equally well.",
                words.again,
                {
                    "camera_focal_px": float(best.state.camera[0]),
                    "other_camera_focal_px": float(alternative.state.camera[0]),
                },
            )


def _intrinsics(fit: CornerFit) -> str:
    camera, projector = fit.state.camera, fit.state.projector
    if fit.state.one_camera:
        return f"a focal length of {camera[0]:.0f} px with a principal point of ({camera[1]:.0f}, {camera[2]:.0f})"
    return f"a camera focal length of {camera[0]:.0f} px with a projector of {projector[0]:.0f} px"


def on_picture_scale(refinement: Refinement) -> list[Finding]:
    """A note on a picture that seems to be scaled in one direction."""
    scale = refinement.scale
    if scale is None or scale.probability < _SCALED:
        return []
    return [
        Finding(
            PICTURE_SCALED,
            Severity.NOTE,
            f"The projector's picture may be scaled in one direction (by {100 * scale.value:+.1f} ± "
            f"{100 * scale.sigma:.1f} % along x, with a probability of {100 * scale.probability:.0f} %; the sigmas "
            "allow for it).",
            "Show it in the projector's own resolution, without keystone correction, zoom or overscan.",
            {
                "aspect_percent": 100 * scale.value,
                "sigma_percent": 100 * scale.sigma,
                "probability_share": scale.probability,
            },
        )
    ]


def _sentences(*parts: Finding | str) -> str:
    return " ".join(map(str, parts))


def _reasons(refinement: Refinement, words: Wording) -> list[str]:
    reasons = []
    for i, cells in enumerate(refinement.captures):
        reasons += reasons_in_images(cells) or reasons_in_space(refinement.fit.state, i, words)
    return reasons


def _because(reasons: list[str]) -> str:
    unique = list(dict.fromkeys(reasons))
    return f": {'; '.join(unique)}." if unique else "."
