"""What a picture shows on the planes that a station sees, posters, boards, stains, anything that is not plain; and the
poses that most matching keypoints of two pictures agree on.

They are looked for in rectified textures of the planes, which look the same from every station. Lowe, "Distinctive
image features from scale-invariant keypoints", 2004; descriptors are compared by Hellinger's distance (Arandjelović and
Zisserman, "Three things everyone should know to improve object retrieval", 2012).

Most matches are wrong. A rigid motion preserves distances, so right pairs are compatible with each other; pairs that
are compatible with the same others vote for one pose (Chen et al., "SC²-PCR: a second order spatial compatibility for
efficient and robust point cloud registration", 2022), by Kabsch's solution of 1976.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics, Plane, Pose, nearest_rotation, tangent_basis
from calib.numerics import Floats, Image, Ints

_DARKEST = 0.02  # share of the brightest level; logarithms of less are noise
_BORDER_PX = 5


def log_brightness(picture: Image) -> NDArray[np.uint8]:
    """Of a picture (H, W) or (H, W, 3), from 0 to 255: steps of it are albedos', however much light falls on them."""
    grey = picture.mean(axis=2) if picture.ndim == 3 else picture
    bright = max(float(np.percentile(grey, 99.5)), 1.0)
    light = np.log(np.clip(grey / bright, 0.0, 1.0) + _DARKEST)
    low, high = np.log(_DARKEST), np.log(1 + _DARKEST)
    levels: NDArray[np.uint8] = np.rint(255 * (light - low) / (high - low)).astype(np.uint8)
    return levels


def rectify_texture(
    light: NDArray[np.uint8], on_plane: NDArray[np.bool_], pixels: Floats
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The drawing (h, w) of camera `pixels` (h, w, 2), NaN for none; and its mask, 255 slightly inside the border of
    `on_plane` (H, W).
    """
    at = np.where(np.isfinite(pixels), pixels, -1e4).astype(np.float32)
    column, row = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
    drawing = cv2.remap(light, column, row, cv2.INTER_LINEAR)
    visible = cv2.remap(on_plane.astype(np.uint8), column, row, cv2.INTER_NEAREST)
    visible = cv2.morphologyEx(visible, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    inside = cv2.erode(visible, np.ones((2 * _BORDER_PX + 1,) * 2, np.uint8), borderValue=0)
    return drawing.astype(np.uint8), (255 * inside).astype(np.uint8)


_MOST_ON_A_PLANE = 300
_LARGEST_PX = 800  # pixels along a side of a plane's drawing
_LEAST_PIXELS = 400  # visible pixels of a plane
_CONTRAST = 0.015
_RATIO = 0.8  # ratio of the distances to the two nearest descriptors (Lowe 2004)
_SAME = 0.01  # tolerance between descriptors, in single precision
_DESCRIPTOR = 128


@dataclass(frozen=True, eq=False)
class Keypoints:
    """`pixels` (N, 2) of the camera; `points` (N, 3) on the planes, in the camera's frame; `labels` (N,): which plane;
    `descriptors` (N, 128), of length 1.
    """

    pixels: Floats
    points: Floats
    labels: Ints
    descriptors: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.labels)


def no_keypoints() -> Keypoints:
    """Of a station without a picture."""
    nothing = np.zeros((0, _DESCRIPTOR), np.float32)
    return Keypoints(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0, np.int64), nothing)


def find_keypoints(
    picture: Image,
    points: NDArray[np.float32],
    labels: NDArray[np.int32],
    planes: tuple[Plane, ...],
    camera: Intrinsics,
) -> Keypoints:
    """Of the lit scene's picture (H, W) or (H, W, 3), on planes as of `StationView`.

    Raises ValueError if it does not have the size of the camera's image.
    """
    if picture.shape[:2] != labels.shape:
        raise ValueError(f"the picture must have the shape {labels.shape}, found {picture.shape[:2]}")
    light = log_brightness(picture)
    parts = [no_keypoints()]
    for label, plane in enumerate(planes):
        on_plane = labels == label
        own = points[on_plane]
        if len(own) >= _LEAST_PIXELS:
            parts.append(_on_plane(light, on_plane, own.astype(np.float64), label, plane, camera))
    return Keypoints(
        np.concatenate([part.pixels for part in parts]),
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.labels for part in parts]),
        np.concatenate([part.descriptors for part in parts]),
    )


def sift(most: int) -> cv2.SIFT:
    """The finder of at most so many keypoints in a picture of `log_brightness`."""
    return cv2.SIFT.create(nfeatures=most, contrastThreshold=_CONTRAST)


def for_hellinger(descriptors: NDArray[Any]) -> NDArray[np.float32]:
    """Descriptors (N, 128) of length 1 whose products compare those of SIFT by Hellinger's distance."""
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12))
    return np.asarray(root, np.float32)


def describe_keypoints(
    picture: NDArray[np.uint8], mask: NDArray[np.uint8], most: int
) -> tuple[Floats, NDArray[np.float32]]:
    """Pixels (N, 2) that stand out where a mask (H, W) is set, at most so many, and their descriptors (N, 128)."""
    keypoints, descriptors = sift(most).detectAndCompute(picture, mask)
    if not keypoints:
        return np.zeros((0, 2)), np.zeros((0, _DESCRIPTOR), np.float32)
    return np.array([keypoint.pt for keypoint in keypoints]), for_hellinger(descriptors)


@lru_cache(maxsize=512)
def match_keypoints(first: Keypoints, second: Keypoints) -> tuple[Ints, Ints]:
    """Mutually best matching keypoints of two stations, (M,) of either."""
    owners = np.arange(len(first)), np.arange(len(second))
    return mutual_matches(first.descriptors, second.descriptors, *owners)


def mutual_matches(
    first: NDArray[np.float32], second: NDArray[np.float32], first_owner: Ints, second_owner: Ints
) -> tuple[Ints, Ints]:
    """Mutually best matching keypoints (M,) of either side, by descriptors (D, 128) of the keypoints `owner` (D,)."""
    if min(len(first), len(second)) < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    product = first @ second.T
    there = _clearly_nearest(product, first_owner, second_owner)
    back = _clearly_nearest(product.T, second_owner, first_owner)
    own = np.flatnonzero(there >= 0)
    mutual: Ints = own[back[there[own]] == own]
    return mutual, there[mutual]


def _clearly_nearest(product: NDArray[np.float32], own: Ints, owner: Ints) -> Ints:
    """For each keypoint, by products of its descriptors' rows with others', the nearest keypoint; −1 where a second one
    is almost as near. `own` and `owner`: the keypoints of rows and columns.
    """
    nearest = product.argmax(axis=1)
    rows = np.arange(len(product))
    rest = np.where(owner == owner[nearest][:, None], np.float32(-1), product)
    near, next_one = (np.sqrt(np.maximum(2 - 2 * best, 0.0)) for best in (product[rows, nearest], rest.max(axis=1)))
    clear = near + _SAME < _RATIO * next_one
    matching = np.full(own.max(initial=-1) + 1, -1)
    worst_first = np.flatnonzero(clear)[np.argsort(-near[clear], kind="stable")]
    matching[own[worst_first]] = owner[nearest[worst_first]]
    return matching


def _on_plane(
    light: NDArray[np.uint8], on_plane: NDArray[np.bool_], own: Floats, label: int, plane: Plane, camera: Intrinsics
) -> Keypoints:
    """`on_plane` (H, W): the plane's pixels, whose points are `own` (N, 3)."""
    axes = tangent_basis(plane.normal)
    places = own @ axes
    low, high = np.percentile(places, (0.5, 99.5), axis=0)
    size = float(np.median(own[:, 2]) / np.mean(camera.focal_px))
    size = max(size, float(np.max(high - low)) / _LARGEST_PX)
    width, height = (np.ceil((high - low) / size).astype(int) + 1).tolist()
    u, v = np.meshgrid(low[0] + size * np.arange(width), low[1] + size * np.arange(height))
    front = np.stack([u, v], axis=-1) @ axes.T + plane.offset * plane.normal
    drawing, mask = rectify_texture(light, on_plane, np.where(front[..., 2:] > 0, camera.project(front), np.nan))
    places, descriptors = describe_keypoints(drawing, mask, _MOST_ON_A_PLANE)
    points = (low + size * places) @ axes.T + plane.offset * plane.normal
    return Keypoints(camera.project(points), points, np.full(len(points), label), descriptors)


_SEEDS, _VOTERS, _KEPT, _ROUNDS = 30, 12, 6, 2


def fit_rigid_motion(here: Floats, there: Floats) -> Pose:
    """The poses (K,) that bring points `there` (K, M, 3) nearest to those `here`."""
    to, of = here.mean(axis=1), there.mean(axis=1)
    rotations = nearest_rotation(np.swapaxes(here - to[:, None], 1, 2) @ (there - of[:, None]))
    return Pose(rotations, to - np.einsum("kij,kj->ki", rotations, of))


def voted_poses(
    first: Keypoints, second: Keypoints, within: float, far: float, alike: tuple[float, float], fewest: int = 3
) -> list[Pose]:
    """X_first = R X_second + t at which at least the `fewest` keypoints coincide `within` a distance, most first.

    `far`: least distance of keypoints that vote together; `alike`: turn in radians and shift that two poses differ by.
    """
    own, matching = match_keypoints(first, second)
    if len(own) < fewest:
        return []
    here, there = first.points[own], second.points[matching]
    apart, beyond = (np.linalg.norm(side[:, None] - side, axis=2) for side in (here, there))
    compatible = ((np.abs(apart - beyond) < within) & (np.minimum(apart, beyond) > far)).astype(np.float32)
    votes = compatible * (compatible @ compatible)
    ranked: list[tuple[int, Pose]] = []
    for seed in np.argsort(-votes.sum(axis=1))[:_SEEDS]:
        voters = np.argsort(-votes[seed])[:_VOTERS]
        near = np.append(voters[votes[seed][voters] > 0], seed)
        for _ in range(_ROUNDS + 1):
            if len(near) < fewest:
                break
            pose = fit_rigid_motion(here[near][None], there[near][None])[0]
            near = np.flatnonzero(np.linalg.norm(pose @ there - here, axis=1) < within)
        if len(near) >= fewest and not any(pose.is_near(better, *alike) for _, better in ranked):
            ranked.append((len(near), pose))
    return [pose for _, pose in sorted(ranked, key=lambda vote: -vote[0])[:_KEPT]]
