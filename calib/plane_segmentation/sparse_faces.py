"""Segment sparse matches of two photos into planes and select the three that form the corner.

A few thousand matches have no neighbourhoods on a pixel grid, so planes are found sequentially: the homography with
most inliers among the remaining matches (MAGSAC++, Barath et al. 2020), until none is left. Then the planes compete:
each match is assigned to the plane that explains it and its neighbours best, each plane is refitted to its matches, and
planes that explain each other's matches are merged.
"""

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
import scipy

from calib.finding import FindingKind
from calib.geometry import NO_FACE, Matches, dehomogenise, homogeneous
from calib.numerics import MEDIAN_LENGTH, Bools, Floats, Ints, singular_refused
from calib.plane_segmentation.segmentation import NO_PLANE
from calib.refusal import PHOTOS, TOO_FEW_MATCHES, TOO_FEW_PLANES, RefusalError

_FEWEST_MATCHES = 60
_FEWEST_ON_A_PLANE = 25
_LEAST_SHARE = 0.03  # of all matches, on a plane
_MOST_PLANES = 8
_OFF_OF_WIDTH = 0.0015  # tolerance in image widths, for lens distortion and errors of features
_RANSAC_STEPS, _CONFIDENCE = 5000, 0.9999
_ROUNDS = 6
_NEIGHBOURS = 9
_ALIKE = 0.7  # share of a plane's matches that another one explains, above which they are merged
_GATE_SIGMAS = 5.0

FACES_MISSING = FindingKind(
    "faces-missing",
    "Faces of the corner in the first two photos were not found in a further one.",
    "Leave this photo out, or take another one with all three faces large in it.",
    ("faces",),
)


@dataclass(frozen=True)
class SparseFaces:
    """`matches`: labelled 0, 1, 2 on the corner's faces and −1 elsewhere; `plane` (N,): every plane, largest first."""

    matches: Matches
    plane: Ints


@singular_refused(PHOTOS)
def find_sparse_faces(matches: Matches, size: tuple[int, int]) -> SparseFaces:
    """Find the planes among matches (N) of two photos of (width, height) and take the three largest that can be faces.

    Raises RefusalError if there are fewer than three.
    """
    plane, count = find_sparse_planes(matches, size)
    if count < 3:
        raise _too_few(plane, count)
    corner = _corner(matches, plane, count)
    face_of = np.full(count + 1, NO_FACE, np.int32)  # the last entry is for NO_PLANE
    face_of[list(corner)] = (0, 1, 2)
    return SparseFaces(matches.with_faces(face_of[plane]), plane)


@singular_refused(PHOTOS)
def find_same_faces(labelled: Matches, matches: Matches, size: tuple[int, int]) -> SparseFaces:
    """Find the planes among matches of the same first photo with another one, numbered like the faces in `labelled`.

    A plane gets the face of most labelled matches near its own in the first photo. Raises RefusalError if a face is not
    found again.
    """
    plane, count = find_sparse_planes(matches, size)
    nearest = labelled.labels[scipy.spatial.cKDTree(labelled.camera_px).query(matches.camera_px)[1]]
    face_of = np.full(count + 1, NO_FACE, np.int32)
    for i in range(count):
        around = nearest[plane == i]
        votes = np.bincount(around[around >= 0], minlength=3)
        if votes.max() > _ALIKE * len(around):
            face_of[i] = np.argmax(votes)
    missing = sorted(set(range(3)) - set(face_of.tolist()))
    if missing:
        raise RefusalError(
            FACES_MISSING,
            f"{len(missing)} of the corner's three faces in the first two photos were not found in this one.",
            FACES_MISSING.remedy,
            {"faces": tuple(missing)},
        )
    return SparseFaces(matches.with_faces(face_of[plane]), plane)


def find_sparse_planes(matches: Matches, size: tuple[int, int]) -> tuple[Ints, int]:
    """Return the plane of each match (N,), largest first and −1 for none, and the number of planes.

    Raises RefusalError if there are too few matches.
    """
    if len(matches) < _FEWEST_MATCHES:
        raise RefusalError(
            TOO_FEW_MATCHES,
            f"Only {len(matches)} matches: too few to find planes in (at least {_FEWEST_MATCHES} are needed).",
            "Take sharper photos closer together, with some texture on all three faces.",
            {"matches": float(len(matches)), "needed_matches": float(_FEWEST_MATCHES)},
        )
    limit_px = _OFF_OF_WIDTH * size[0]
    planes = _one_after_the_other(matches, limit_px)
    plane, planes = _assign_to_planes(matches, planes, limit_px)
    return plane, len(planes)


def _one_after_the_other(matches: Matches, limit_px: float) -> list[Floats]:
    remaining = np.arange(len(matches))
    least = _least(len(matches))
    planes: list[Floats] = []
    while len(remaining) >= least and len(planes) < _MOST_PLANES:
        homography = _homography(matches[remaining], limit_px)
        if homography is None:
            break
        on = _off(homography, matches[remaining]) <= limit_px
        if on.sum() < least:
            break
        planes.append(homography)
        remaining = remaining[~on]
    return planes


def _assign_to_planes(matches: Matches, planes: list[Floats], limit_px: float) -> tuple[Ints, list[Floats]]:
    """The plane of each match (N,), −1 for none, and the planes, largest first."""
    around: Ints = np.asarray(
        scipy.spatial.cKDTree(matches.camera_px).query(matches.camera_px, min(_NEIGHBOURS, len(matches)))[1]
    )
    plane = np.full(len(matches), NO_PLANE, np.int32)
    for _ in range(_ROUNDS):
        if not planes:
            break
        off, best, own = _best_planes(matches, planes, around, limit_px)
        plane = np.where(own <= limit_px, best, NO_PLANE).astype(np.int32)
        planes = _fitted_again(matches, plane, _without_doubles(planes, off, plane, limit_px), limit_px)
    if not planes:
        return np.full(len(matches), NO_PLANE, np.int32), []
    return _final(matches, planes, around, limit_px)


def _best_planes(matches: Matches, planes: list[Floats], around: Ints, limit_px: float) -> tuple[Floats, Ints, Floats]:
    """Return transfer errors (n, N) of all planes, the best plane (N,) for a match and its neighbours, its errors."""
    off = np.stack([_off(plane, matches) for plane in planes])
    best = np.argmin(np.minimum(off, limit_px)[:, around].mean(axis=2), axis=0).astype(np.int32)
    return off, best, off[best, np.arange(len(matches))]


def _final(matches: Matches, planes: list[Floats], around: Ints, limit_px: float) -> tuple[Ints, list[Floats]]:
    _, best, own = _best_planes(matches, planes, around, limit_px)
    sigma = float(np.median(own[own <= limit_px])) / MEDIAN_LENGTH if np.any(own <= limit_px) else 0.0
    on = own <= min(limit_px, max(_GATE_SIGMAS * sigma, 0.2 * limit_px))
    order = np.argsort(-np.bincount(best[on], minlength=len(planes)), kind="stable")
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    return np.where(on, rank[best], NO_PLANE).astype(np.int32), [planes[i] for i in order]


def _without_doubles(planes: list[Floats], off: Floats, plane: Ints, limit_px: float) -> list[int]:
    """Select the planes whose matches no larger plane explains as well."""
    counts = np.bincount(plane[plane >= 0], minlength=len(planes))
    kept: list[int] = []
    for i in map(int, np.argsort(-counts, kind="stable")):
        members = plane == i
        if counts[i] and all(np.mean(off[j, members] <= limit_px) < _ALIKE for j in kept):
            kept.append(i)
    return kept


def _fitted_again(matches: Matches, plane: Ints, kept: list[int], limit_px: float) -> list[Floats]:
    least = _least(len(matches))
    members = [plane == i for i in kept]
    fitted = [_homography(matches[of], limit_px) for of in members if of.sum() >= least]
    return [homography for homography in fitted if homography is not None]


def _least(count: int) -> int:
    return max(_FEWEST_ON_A_PLANE, round(_LEAST_SHARE * count))


def _homography(matches: Matches, limit_px: float) -> Floats | None:
    homography, _ = cv2.findHomography(
        matches.camera_px, matches.projector_px, cv2.USAC_MAGSAC, limit_px, None, _RANSAC_STEPS, _CONFIDENCE
    )
    return None if homography is None else np.asarray(homography, np.float64)


def _off(homography: Floats, matches: Matches) -> Floats:
    """Transfer error (N,) of a homography, in px of the second photo; infinite behind its horizon."""
    mapped = homogeneous(matches.camera_px) @ homography.T
    ahead: Bools = mapped[:, 2] * np.median(mapped[:, 2]) > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.linalg.norm(dehomogenise(mapped) - matches.projector_px, axis=1)
    return np.where(ahead & np.isfinite(off), off, np.inf)


def _corner(matches: Matches, plane: Ints, count: int) -> tuple[int, int, int]:
    """Select the three planes that fill most of the picture, by matches and extent.

    The calibration tests whether they are perpendicular.
    """
    counts = np.bincount(plane[plane >= 0], minlength=count).astype(np.float64)
    areas = np.array([_area(matches.camera_px[plane == i]) for i in range(count)])
    weight = np.sqrt(counts * areas)
    return max(combinations(range(count), 3), key=lambda triple: float(np.prod(weight[list(triple)])))


def _area(pixels: Floats) -> float:
    return float(cv2.contourArea(cv2.convexHull(pixels.astype(np.float32)))) if len(pixels) > 2 else 0.0


def _too_few(plane: Ints, count: int) -> RefusalError:
    share = float(np.mean(plane >= 0))
    if count == 0:
        advice = "Choose a corner with little in front of it."
        return RefusalError(TOO_FEW_PLANES, "No plane was found in the matches.", advice, {"planes": 0.0})
    if count == 1:
        return RefusalError(
            TOO_FEW_PLANES,
            f"Only one plane was found, with {share:.0%} of the matches: a flat wall, or photos from one place (a "
            "camera that is only turned or zoomed sees no depth).",
            PHOTOS.move,
            {"planes": 1.0},
        )
    return RefusalError(
        TOO_FEW_PLANES,
        f"Only two planes were found, with {share:.0%} of the matches; a corner has three.",
        "Get the floor or the ceiling into both photos as well as both walls, each with something to match on it.",
        {"planes": 2.0},
    )
