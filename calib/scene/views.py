"""Views of a scene for a calibration without a corner: keypoints of each picture, with the projector pixels there.

A keypoint is found in the camera's picture, to a third of a pixel or so; where it is in the projector's, the matches
around it tell a hundred times as accurately for the same point of the surface. So each keypoint carries the affine map
from camera to projector pixels at its place: an error along the surface moves both pixels together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from calib.geometry import Matches, Size
from calib.numerics import Bools, Floats, Image, Ints, at_random
from calib.registration import for_hellinger, log_brightness, mutual_matches, sift
from calib.scene.rigid_scene import StationMatches

_MOST = 800  # keypoints of a picture as it looks from one side
_TILTS, _TURN_DEG = 2, 72.0  # simulated views: slants up to 60°, turned by 72° over each tilt
_ONE_PLACE_PX = 1.0
_HALF_WINDOW = 3  # pixels around a keypoint whose matches tell its place in the projector
WINDOW_PIXELS = (2 * _HALF_WINDOW + 1) ** 2
_FEWEST = 30  # matches in the window
_MOST_BEND_PX = 0.5  # rms of the window's matches about a quadratic map: more is an edge
_RESTS_PX = 1.0  # the same camera pixel sees the same projector pixel in another view


@dataclass(frozen=True, eq=False)
class MatchedView:
    """What one station of an unchanged rig saw of a rigid scene."""

    matches: Matches
    """All that moved against the rig since another station."""
    brightness: NDArray[np.uint8]
    """(H, W): logarithm of the picture."""
    places: Floats
    """(H, W, 3): the projector's pixel and its sigma at each camera pixel; NaN where there is none, and where what is
    seen rests against the rig."""

    @property
    def without_picture(self) -> "MatchedView":
        """The same with a picture that shows nothing."""
        return replace(self, brightness=np.zeros_like(self.brightness))


@dataclass(frozen=True, eq=False)
class SceneView(MatchedView):
    """The same with keypoints of the picture, by which stations are recognised in each other."""

    camera_px: Floats
    """(K, 2): keypoints in the camera's picture."""
    projector_px: Floats
    """(K, 2): the same in the projector's."""
    slope: Floats
    """(K, 2, 2): derivatives of the projector's pixel by the camera's, along the surface."""
    sigma_px: Floats
    """(K,): standard deviation of each coordinate of `projector_px`, for a given camera pixel."""
    descriptors: NDArray[np.float32]
    """(D, 128), of length 1: several of a keypoint, as it looks from several sides."""
    owner: Ints
    """(D,): the keypoint of each descriptor."""

    def __len__(self) -> int:
        return len(self.camera_px)


@dataclass(frozen=True, eq=False)
class Lifted:
    """What the matches around camera pixels tell of them."""

    projector_px: Floats
    """(K, 2)."""
    slope: Floats
    """(K, 2, 2): derivatives of the projector's pixel by the camera's, along the surface."""
    sigma_px: Floats
    """(K,): standard deviation of each coordinate of a match's projector pixel, for a given camera pixel."""
    rms_px: Floats
    """(K,): of the matches about a quadratic map; infinite where there are too few."""

    def __getitem__(self, kept: Bools | Ints) -> "Lifted":
        return Lifted(self.projector_px[kept], self.slope[kept], self.sigma_px[kept], self.rms_px[kept])

    @property
    def is_smooth(self) -> Bools:
        """Where the matches around are on one surface, (K,)."""
        smooth: Bools = self.rms_px < _MOST_BEND_PX
        return smooth

    @property
    def bend(self) -> Floats:
        """How much more than their sigma the matches are off the map, (K,)."""
        return self.rms_px / self.sigma_px


def views_of(
    captures: Sequence[tuple[Matches, Image]], camera_size: tuple[int, int]
) -> tuple[list[MatchedView], float]:
    """Views of captures with pictures (H, W) or (H, W, 3), and the share of matches that rested in all of them.

    What is at the same pixel of both devices in most other captures did not move against the rig: the table around a
    turntable. It is left out, for the rest moved differently. Raises ValueError if a picture has another size.
    """
    maps = [_map_of(matches, camera_size) for matches, _ in captures]
    resting = [_resting(maps, number) for number in range(len(maps))]
    views = []
    for (matches, picture), places, rests in zip(captures, maps, resting, strict=True):
        if picture.shape[:2] != places.shape[:2]:
            raise ValueError(f"the picture must have the shape {places.shape[:2]}, found {picture.shape[:2]}")
        column, row = np.rint(matches.camera_px).astype(np.int64).T
        own = np.where(rests[..., None], np.nan, places)
        views.append(MatchedView(matches[~rests[row, column]], log_brightness(picture), own))
    decoded = sum(int(np.isfinite(places[..., 0]).sum()) for places in maps)
    return views, sum(int(rests.sum()) for rests in resting) / max(decoded, 1)


def matched_pairs(views: Sequence[SceneView]) -> dict[tuple[int, int], tuple[Ints, Ints]]:
    """Mutually best matching keypoints (M,) of every two views, without those that rest against the rig."""
    pairs = {}
    for i, j in combinations(range(len(views)), 2):
        own, matching = mutual_matches(views[i].descriptors, views[j].descriptors, views[i].owner, views[j].owner)
        apart = np.abs(views[i].camera_px[own] - views[j].camera_px[matching]).max(axis=1, initial=0.0)
        lit = np.abs(views[i].projector_px[own] - views[j].projector_px[matching]).max(axis=1, initial=0.0)
        moved = np.maximum(apart, lit) > 2 * _RESTS_PX
        pairs[i, j] = own[moved], matching[moved]
    return pairs


def some_matches(captures: Sequence[Matches], count: int) -> StationMatches:
    """At most `count` matches of each station's at random, with sigmas: 1 where none are stated."""
    chosen = [matches[at_random(len(matches), count)] for matches in captures]
    matches = Matches(
        np.concatenate([matches.camera_px for matches in chosen]),
        np.concatenate([matches.projector_px for matches in chosen]),
        None,
        np.concatenate([_sigma(matches) for matches in chosen]),
    )
    return StationMatches(matches, np.repeat(np.arange(len(chosen)), [len(matches) for matches in chosen]))


def _sigma(matches: Matches) -> Floats:
    return np.full(len(matches), 1.0) if matches.sigma_px is None else matches.sigma_px


def _map_of(matches: Matches, size: tuple[int, int]) -> Floats:
    """The projector's pixel and its sigma at each camera pixel, (H, W, 3); NaN where there is none."""
    width, height = Size(*size)
    places = np.full((height, width, 3), np.nan)
    column, row = np.rint(matches.camera_px).astype(np.int64).T
    places[row, column, :2], places[row, column, 2] = matches.projector_px, _sigma(matches)
    return places


def _resting(maps: Sequence[Floats], number: int) -> Bools:
    """Where a view sees what it sees in most of the others, (H, W)."""
    x, y = maps[number][..., 0], maps[number][..., 1]
    row, column = np.nonzero(np.isfinite(x))
    x, y = x[row, column], y[row, column]
    same, seen_count = np.zeros(len(row), np.int64), np.zeros(len(row), np.int64)
    for k, places in enumerate(maps):
        if k != number:
            pixels_there = places[row, column]
            seen_count += np.isfinite(pixels_there[:, 0])
            same += (np.abs(pixels_there[:, 0] - x) < _RESTS_PX) & (np.abs(pixels_there[:, 1] - y) < _RESTS_PX)
    rests = np.zeros(maps[number].shape[:2], np.bool_)
    rests[row, column] = (2 * same > seen_count) & (seen_count > 0)
    return rests


def with_keypoints(view: MatchedView) -> SceneView:
    """The view with the keypoints of its picture."""
    side = 2 * _HALF_WINDOW + 1
    known = np.isfinite(view.places[..., 0]).astype(np.uint8)
    inside = np.asarray(cv2.erode(known, np.ones((side, side), np.uint8)), np.uint8)
    pixels, owner, descriptors = _keypoints(view.brightness, inside)
    lifted = lift(view.places, pixels)
    is_smooth = lifted.is_smooth
    kept = is_smooth[owner]
    number = np.cumsum(is_smooth) - 1
    return SceneView(
        view.matches,
        view.brightness,
        view.places,
        pixels[is_smooth],
        lifted.projector_px[is_smooth],
        lifted.slope[is_smooth],
        lifted.sigma_px[is_smooth],
        descriptors[kept],
        number[owner[kept]],
    )


def _keypoints(picture: NDArray[np.uint8], mask: NDArray[np.uint8]) -> tuple[Floats, Ints, NDArray[np.float32]]:
    """Keypoints (K, 2) of a picture as it looks from several sides, and their descriptors (D, 128) with owners (D,).

    Yu and Morel, "ASIFT: an algorithm for fully affine invariant comparison", 2011. What is found at one place in
    several of the simulated views is one keypoint.
    """
    finder = cv2.AffineFeature.create(sift(_MOST), maxTilt=_TILTS, rotateStepBase=_TURN_DEG)
    keypoints, descriptors = finder.detectAndCompute(picture, mask)
    if not keypoints:
        return np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros((0, 128), np.float32)
    order = np.argsort([-keypoint.response for keypoint in keypoints], kind="stable")
    pixels = np.array([keypoint.pt for keypoint in keypoints])[order]
    within = scipy.spatial.cKDTree(pixels).query_ball_point(pixels, _ONE_PLACE_PX)
    owner = np.array([min(near) for near in within], np.int64)
    owner = owner[owner]  # a chain of near keypoints belongs to the strongest
    strongest, owner = np.unique(owner, return_inverse=True)
    return pixels[strongest], owner.astype(np.int64), for_hellinger(descriptors[order])


def lift(places: Floats, pixels: Floats) -> Lifted:
    """Projector pixels at camera pixels (K, 2), by a quadratic map of the `places` (H, W, 3) around."""
    fit, rms, sigma = quadratic_maps(places, pixels, _HALF_WINDOW)
    return Lifted(fit[:, 0], np.swapaxes(fit[:, 1:3], 1, 2), np.maximum(sigma, 1e-3), rms)


def monomials(x: Floats, y: Floats) -> Floats:
    """1, x, y, x², x y, y² of values (...), (..., 6)."""
    return np.stack([np.ones(x.shape), x, y, x**2, x * y, y**2], axis=-1)


def quadratic_maps(places: Floats, pixels: Floats, half: int) -> tuple[Floats, Floats, Floats]:
    """Quadratic maps to projector pixels from the offset to camera pixels (K, 2): coefficients (K, 6, 2) of
    `monomials`, the rms (K,) of the `places` (H, W, 3) about them, infinite where there are too few, and their mean
    sigma (K,).

    By the places up to `half` pixels away in both directions.
    """
    height, width = places.shape[:2]
    steps = np.arange(-half, half + 1)
    column, row = np.rint(pixels).astype(np.int64).T
    x = np.clip(column[:, None, None] + steps[None, None, :], 0, width - 1)
    y = np.clip(row[:, None, None] + steps[None, :, None], 0, height - 1)
    x, y = np.broadcast_arrays(x, y)
    around = places[y, x].reshape(len(pixels), len(steps) ** 2, 3)
    known = np.isfinite(around[..., 0])
    right, down = (at.reshape(known.shape) - pixels[:, k : k + 1] for k, at in enumerate((x, y)))
    design = monomials(right, down)
    weighted = design * known[..., None]
    values = np.where(known[..., None], around[..., :2], 0.0)
    normal = np.einsum("kni,knj->kij", weighted, design) + 1e-9 * np.eye(design.shape[2])
    fit = np.linalg.solve(normal, np.einsum("kni,knj->kij", weighted, values))
    off = (values - np.einsum("kni,kij->knj", design, fit)) * known[..., None]
    count = known.sum(axis=1)
    rms = np.sqrt(np.sum(off**2, axis=(1, 2)) / np.maximum(2 * count - 12, 1))
    sigma = np.where(known, around[..., 2], 0.0).sum(axis=1) / np.maximum(count, 1)
    rms[count < _FEWEST] = np.inf
    return fit, rms, sigma
