"""Segment dense matches into planes and select the three that form the corner, without calibration or masks."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from calib.finding import FindingKind
from calib.geometry import NO_FACE, Matches
from calib.numerics import Floats, Ints, compiled, in_pieces, singular_refused
from calib.plane_segmentation.corner_hypotheses import Triple, Triples, corner_triples, outermost
from calib.plane_segmentation.labelling import label_matches
from calib.plane_segmentation.segmentation import NO_PLANE, Segments, segmentations
from calib.plane_segmentation.surfels import make_surfels
from calib.refusal import RIG, TOO_FEW_MATCHES, TOO_FEW_PLANES, RefusalError

_SEED = 20240
_FEWEST_MATCHES = 1500
_FEWEST_SURFELS = 60
_LEAST_SMOOTH = 0.1
_NOTABLE_PX = 0.3
# Assumes independent errors of surfels; neighbours have similar errors, so the true sigma is several times larger.
_MOST_DIRECTION_SIGMA_DEG = 0.2
# Log odds that the projector distorts its image; −7 to −4 for undistorted images. Walls and furniture a degree or two
# off square, or an off-centre principal point, can look like a small distortion.
_CLEARLY_OBLONG, _NOTABLY_OBLONG = 5.0, 0.05
# Deviation of log aspect and skew from a diamond array's, within which focal lengths are tried only coarsely.
_AS_DIAMOND = 0.1

NOT_SMOOTH = FindingKind(
    "matches-not-smooth",
    "Neighbouring camera pixels are matched to scattered projector pixels.",
    "Check focus, exposure, and that the frames belong to the patterns they are listed with.",
)
OBLONG_PIXELS = FindingKind(
    "oblong-pixels",
    "The planes are those of a room only if the projector's pixels are oblong or skewed.",
    "Switch keystone correction and zoom off, and show the picture pixel for pixel.",
    ("planes", "off_square_share"),
)
NO_PERPENDICULAR_PLANES = FindingKind(
    "no-perpendicular-planes",
    "Of the planes that were found, no three are clearly perpendicular to each other.",
    "Capture the corner of a room, or three faces of a box, with all three faces large in the picture.",
    ("planes", "direction_sigma_deg"),
)


@dataclass(frozen=True)
class PlaneHomography:
    """What a plane is before anything is calibrated."""

    homography: Floats
    """(3, 3): camera → projector, for pixels from which the estimated lens distortion has been removed."""
    matches: int
    """How many lie on it."""
    face: int | None
    """0, 1 or 2 if it is a face of the corner."""


@dataclass(frozen=True)
class Faces:
    """The faces of the corner among the planes of the scene."""

    matches: Matches
    """Labelled 0, 1, 2 on the corner's faces (0 the largest) and −1 elsewhere."""
    planes: tuple[PlaneHomography, ...]
    """All planes found, largest first."""
    plane: Ints
    """Index of each match's plane, −1 for none, (N,)."""


@singular_refused(RIG)
def find_faces(
    matches: Matches,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    principal_point_px: tuple[float, float] | None = None,
) -> Faces:
    """Segment matches (N) into planes and choose the three that form a cuboid corner; sizes are (width, height).
    `principal_point_px`: the camera's, if that is known; else the image's centre stands for it.

    Raises RefusalError if there are fewer than three planes or no three of them can be a corner.
    """
    if len(matches) < _FEWEST_MATCHES:
        raise RefusalError(
            TOO_FEW_MATCHES,
            f"Only {len(matches)} matches: too few to find planes in (at least {_FEWEST_MATCHES} are needed).",
            "Check that camera and projector see the same part of the room, light and exposure; or label the faces.",
            {"matches": float(len(matches)), "needed_matches": float(_FEWEST_MATCHES)},
        )
    rng = np.random.default_rng(_SEED)
    surfels = make_surfels(matches, camera_size, rng)
    if len(surfels) < max(_FEWEST_SURFELS, _LEAST_SMOOTH * surfels.tried):
        raise RefusalError(
            NOT_SMOOTH,
            "The matches are not smooth: neighbouring camera pixels are matched to scattered projector pixels.",
            NOT_SMOOTH.remedy,
        )
    point = (0.0, 0.0) if principal_point_px is None else _ideal_point(principal_point_px, camera_size)
    segments, certain = _with_corner(segmentations(surfels, camera_size, projector_size, rng), surfels.camera_px, point)
    plane, counts = label_matches(matches, surfels, segments, rng)
    return _faces(matches, segments, plane, counts, outermost(certain, segments).planes)


def _with_corner(
    tried: Iterable[Segments], camera_px: Floats, point: tuple[float, float]
) -> tuple[Segments, list[Triple]]:
    """Return the first segmentation in which three planes can be a corner, and all such triples, best first."""
    refusal: RefusalError | None = None
    for segments in tried:
        triples = corner_triples(segments, camera_px, point)
        certain = [triple for triple in triples.square if triple.direction_sigma_deg < _MOST_DIRECTION_SIGMA_DEG]
        if certain and triples.oblong_nats > _CLEARLY_OBLONG and triples.off_square > _NOTABLY_OBLONG:
            raise _oblong(segments, triples)
        if certain:
            return segments, certain
        refusal = refusal or (_too_few(segments) if len(segments.planes) < 3 else _no_corner(segments, triples))
    assert refusal is not None
    raise refusal


def _too_few(segments: Segments) -> RefusalError:
    share, uneven = np.mean(segments.label >= 0), _unevenness(segments)
    if len(segments.planes) == 0:
        return RefusalError(
            TOO_FEW_PLANES,
            f"No plane was found in the matches{uneven}.",
            "Capture the corner of a room with little in front of it.",
            {"planes": 0.0},
        )
    if len(segments.planes) == 1:
        return RefusalError(
            TOO_FEW_PLANES,
            f"Only one plane was found, with {share:.0%} of the matches{uneven}: a flat wall, or a projector that "
            "stands where the camera stands.",
            "Turn to the corner of a room so that two walls and the floor or ceiling are lit, "
            "and keep camera and projector apart.",
            {"planes": 1.0},
        )
    return RefusalError(
        TOO_FEW_PLANES,
        f"Only two planes were found, with {share:.0%} of the matches{uneven}; a corner has three.",
        "Tilt the rig so that the floor or ceiling is lit as well as both walls, each over a good part of the picture.",
        {"planes": 2.0},
    )


def _oblong(segments: Segments, triples: Triples) -> RefusalError:
    return RefusalError(
        OBLONG_PIXELS,
        f"{len(segments.planes)} planes were found. They are parallel or perpendicular to each other, as walls and "
        f"furniture are, if the projector's pixels are oblong or skewed by {triples.off_square:.0%}, but hardly so if "
        "they are square.",
        RIG.shape.strip(),
        {"planes": float(len(segments.planes)), "off_square_share": float(triples.off_square)},
    )


def _no_corner(segments: Segments, triples: Triples) -> RefusalError:
    advice = "Capture the corner of a room, or three faces of a box, with all three faces large in the picture."
    count, uneven = f"{len(segments.planes)} planes were found", _unevenness(segments)
    if not triples.square:
        reason = f"{count}{uneven}, but no three of them are perpendicular to each other."
        if triples.off_diamond < _AS_DIAMOND:
            reason += " Three would be if the projector's pixels were twice as wide as high, as in a diamond array."
            advice = (
                "If its mirrors are a diamond array (DLP LightCrafter), set projector.pixel_aspect to 0.5, or import "
                "the frames with --pixel-aspect 0.5: all is then in square pixels. "
                f"Otherwise: {advice[0].lower()}{advice[1:]}"
            )
        return RefusalError(NO_PERPENDICULAR_PLANES, reason, advice, {"planes": float(len(segments.planes))})
    sigma = min(triple.direction_sigma_deg for triple in triples.square)
    return RefusalError(
        NO_PERPENDICULAR_PLANES,
        f"{count}{uneven}; three could be perpendicular, but are too small or too uneven to tell (by {sigma:.1f}°).",
        advice,
        {"planes": float(len(segments.planes)), "direction_sigma_deg": float(sigma)},
    )


def _unevenness(segments: Segments) -> str:
    if segments.model_px < _NOTABLE_PX:
        return ""
    return f" (surfaces or decoding deviate from planes by some {segments.model_px:.1f} projector pixels)"


def _faces(matches: Matches, segments: Segments, plane: Ints, counts: Ints, corner: tuple[int, int, int]) -> Faces:
    view, planes = segments.view, segments.planes
    order = np.argsort(-counts, kind="stable")
    # The last entry is for matches on none.
    rank, face_of = np.full(len(planes) + 1, NO_PLANE, np.int32), np.full(len(planes) + 1, NO_FACE, np.int32)
    rank[order] = np.arange(len(order))
    face_of[[index for index in order if index in corner]] = (0, 1, 2)
    to_camera, to_projector = _pixel_scale(view.camera.size_px), _pixel_scale(view.projector.size_px)
    listed = []
    for index in order:
        homography = np.linalg.inv(to_projector) @ view.homography(planes[index]) @ to_camera
        face = int(face_of[index])
        listed.append(
            PlaneHomography(
                homography / np.linalg.norm(homography), int(counts[index]), None if face == NO_FACE else face
            )
        )
    label = np.empty_like(plane)
    in_pieces(len(plane), lambda at: _renumber(rank, face_of, plane[at], label[at]))
    return Faces(matches.with_faces(label), tuple(listed), plane)


@compiled
def _renumber(rank: Ints, face_of: Ints, plane: Ints, label: Ints) -> None:
    """Planes (N,) by their rank (n + 1,), and the face of each, (n + 1,) → (N,)."""
    for i in range(len(plane)):
        label[i], plane[i] = face_of[plane[i]], rank[plane[i]]


def _ideal_point(point_px: tuple[float, float], size_px: tuple[int, int]) -> tuple[float, float]:
    """In the coordinates of calib.plane_segmentation.plane_parallax, where the lens leaves it."""
    x, y, _ = _pixel_scale(size_px) @ (*point_px, 1.0)
    return float(x), float(y)


def _pixel_scale(size_px: tuple[int, int]) -> Floats:
    """Pixels → the coordinates of calib.plane_segmentation.plane_parallax, (3, 3)."""
    width, height = size_px
    return np.array([[2 / width, 0, -(width - 1) / width], [0, 2 / width, -(height - 1) / width], [0, 0, 1.0]])
