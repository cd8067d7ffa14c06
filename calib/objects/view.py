"""A thing as one station saw it: an organised cloud, patches drawn evenly over it, and what its picture shows on it."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics
from calib.numerics import Bools, Floats, Image, Ints
from calib.registration import (
    Keypoints,
    Patches,
    RangeImage,
    describe_keypoints,
    log_brightness,
    no_keypoints,
    relative_noise,
    sample_evenly,
)

PATCHES = 3000  # drawn from each view; with fewer pixels than that, it is seen too small or too dark
STEEPEST = 0.35  # cosine of the slant beyond which a patch's area is unreliable
_PARTS_ACROSS = 6
PARTS = _PARTS_ACROSS**2
_WINDOW = 7  # window of the normals in pixels; larger with noise
_AROUND = 5  # uncertainty of the edges of things, in pixels
FEWEST_PIXELS = _AROUND**4  # of a view
_MARKS = 500
_OF_SIZE = 1 / 60  # the grain over the size: spacing of points for features and coarse alignment


@dataclass(frozen=True, eq=False)
class ObjectView:
    """A thing by itself, before what else its camera saw."""

    image: RangeImage
    """Points and normals of the thing; depths of the background as well."""
    camera: Intrinsics
    pixel: Ints
    """(M,): flat indices of the patches, in random order, drawn evenly over the surface."""
    noise: float
    """Standard deviation of a point along its ray, over the squared depth."""
    grain: float
    """Spacing of points that a coarse alignment needs, in their unit."""
    keypoints: Keypoints
    """None without a picture."""

    @cached_property
    def patches(self) -> Patches:
        """M of them."""
        return Patches(*(values.reshape(-1, 3)[self.pixel].astype(np.float64) for values in self.image[:2]))

    @property
    def middle(self) -> Floats:
        """Of the patches, (3,)."""
        return np.median(self.patches.points, axis=0)

    def pixels(self, flat: Ints) -> Floats:
        """Columns and rows (N, 2) of flat indices."""
        row, column = np.divmod(flat, self.image.depth.shape[1])
        return np.stack([column, row], axis=1).astype(np.float64)

    @cached_property
    def _extent(self) -> tuple[Floats, Floats]:
        """The patches' least pixel (2,), and how far they spread (2,)."""
        pixels = self.pixels(self.pixel)
        return pixels.min(axis=0), np.ptp(pixels, axis=0) + 1

    def parts(self, pixels: Floats) -> Ints:
        """Which of PARTS parts of the picture pixels (N, 2) are in, (N,)."""
        low, size = self._extent
        column, row = np.clip((pixels - low) / size * _PARTS_ACROSS, 0, _PARTS_ACROSS - 1).astype(np.int64).T
        number: Ints = row * _PARTS_ACROSS + column
        return number

    @cached_property
    def inner(self) -> Bools:
        """Mask (H·W,) of pixels surrounded by the thing.

        Windows at the rim are one-sided: their normals are those of a place farther inside, and because the surface
        curves away there, they are biased towards the camera.
        """
        there = np.isfinite(self.image.points[..., 2]).astype(np.uint8)
        square = np.ones((_WINDOW, _WINDOW), np.uint8)
        return cv2.erode(there, square, borderType=cv2.BORDER_CONSTANT, borderValue=0).ravel() > 0

    def facing(self, flat: Ints) -> Floats:
        """Cosine of the slant (N,)."""
        points, normals = (values.reshape(-1, 3)[flat].astype(np.float64) for values in self.image[:2])
        cosine: Floats = np.abs(np.sum(points * normals, axis=1)) / np.linalg.norm(points, axis=1)
        return cosine

    def sigma(self, flat: Ints) -> Floats:
        """Standard deviation of points along their normals (N,)."""
        depth = self.image.points.reshape(-1, 3)[flat, 2].astype(np.float64)
        sigma: Floats = self.noise * depth**2 * np.maximum(self.facing(flat), STEEPEST)
        return sigma


def view_of(
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    camera: Intrinsics,
    resting: NDArray[np.float32] | None = None,
    picture: Image | None = None,
) -> ObjectView | None:
    """The view of a cloud (H, W, 3) of `calib.pointcloud`; `resting` (H, W): the depth of the background.

    `picture` (H, W) or (H, W, 3): of the lit scene. None if the thing is not visible.
    """
    depth = np.where(np.isfinite(points[..., 2]), points[..., 2], np.float32(0))
    there = (depth > 0) & np.isfinite(normals[..., 2])
    if resting is not None:
        there &= ~(resting > 0)
        depth = np.maximum(depth, resting)
    there = without_small_pieces(there)
    if np.count_nonzero(there) < FEWEST_PIXELS:
        return None
    own = np.where(there[..., None], points, np.float32(np.nan))
    turned = np.where(there[..., None], normals, np.float32(np.nan))
    known = np.where(depth > 0, depth, np.float32(np.inf))
    near = np.asarray(cv2.erode(known, np.ones((_AROUND, _AROUND), np.uint8)), np.float32)
    patches = sample_evenly(own, turned, PATCHES, STEEPEST, beyond=False)
    size = float(np.linalg.norm(np.ptp(own[there], axis=0)))
    keypoints = no_keypoints() if picture is None else _keypoints(picture, own, there)
    lens = np.array([*camera.focal_px, *camera.principal_point_px, *camera.distortion], np.float64)
    image = RangeImage(own, turned, depth, near, lens)
    return ObjectView(image, camera, patches, relative_noise(own, turned), _OF_SIZE * size, keypoints)


def without_small_pieces(there: Bools) -> Bools:
    """The pieces (H, W) that are not small compared with the largest."""
    count, label, statistics, _ = cv2.connectedComponentsWithStats(there.astype(np.uint8), connectivity=4)
    if count < 2:
        return there
    area = statistics[:, cv2.CC_STAT_AREA]
    large = area >= 0.05 * area[1:].max()
    large[0] = False
    kept: Bools = large[label]
    return kept


def _keypoints(picture: Image, points: NDArray[np.float32], there: Bools) -> Keypoints:
    """SIFT's, on the thing, lifted to its surface."""
    inside = np.asarray(cv2.erode(there.astype(np.uint8), np.ones((_AROUND, _AROUND), np.uint8)), np.uint8)
    pixels, descriptors = describe_keypoints(log_brightness(picture), inside, _MARKS)
    column, row = np.rint(pixels).astype(np.int64).T
    lifted = points[row, column].astype(np.float64)
    on = np.isfinite(lifted[:, 2])
    return Keypoints(pixels[on], lifted[on], np.full(int(on.sum()), -1), descriptors[on])
