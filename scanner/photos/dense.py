"""Dense matching of two calibrated photos: rectification, then OpenCV's semi-global matching (Hirschmüller 2008)."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Intrinsics, Matches, intersect
from calib.numerics import Floats, Image
from calib.pointcloud import surface
from scanner.photos.photo import Photo

_LONGEST_SIDE = 1600  # longest side of the matched photos; beyond it, cost grows more than detail
_BLOCK = 5
_DISPARITY_STEP = 16  # OpenCV searches multiples of this
_MOST_DISPARITIES = 400
_RAREST = 0.5  # per cent of the sparse matches left out at either end of the range
_SPARE, _SPARE_PX = 0.05, 8.0


@dataclass(frozen=True)
class DenseCloud:
    """Points (H, W, 3) in the first photo's frame, on the grid of its rectified picture, NaN for none.

    `colours` (H, W, 3) RGB, `normals` (H, W, 3) facing the first camera.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8]
    normals: NDArray[np.float32]
    unit: str


@dataclass(frozen=True)
class _Rectified:
    """A photo in a frame whose x axis is the baseline: `low` (2,) is its first pixel, `focal_px` is common to both
    photos.

    `rotation` (3, 3): from the photo's frame into the common one.
    """

    rotation: Floats
    focal_px: float
    low: Floats
    size: tuple[int, int]

    def rays(self) -> Floats:
        """Return the rays of its pixels in the common frame, (H, W, 3) at z = 1."""
        width, height = self.size
        x, y = np.meshgrid(np.arange(width) + self.low[0], np.arange(height) + self.low[1])
        return np.stack([x / self.focal_px, y / self.focal_px, np.ones_like(x)], axis=-1)

    def picture(self, photo: Photo, camera: Intrinsics) -> Image:
        """The photo as it would be in this frame, without its lens."""
        pixels = camera.project(self.rays() @ self.rotation).astype(np.float32)
        outside = np.float32(-1e6)  # beyond the lens model, as outside the photo
        maps = np.where(np.isfinite(pixels), pixels, outside)
        rectified = cv2.remap(photo.pixels, maps[..., 0], maps[..., 1], cv2.INTER_CUBIC, borderValue=0)
        return np.asarray(rectified, np.uint8)


def dense_cloud(first: Photo, second: Photo, calibration: Calibration, matches: Matches) -> DenseCloud:
    """Points of every pixel of the first photo with a match in the second.

    `matches` determine the range of disparities. Parts that moved, shine or repeat may be wrong; pixels whose
    disparities differ between the two directions of matching are left out.
    """
    left, right, least, count = _rectified(calibration, matches)
    pictures = left.picture(first, calibration.camera), right.picture(second, calibration.projector)
    matched = _match(*pictures, least, count)
    disparity = matched + left.low[0] - right.low[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(
            np.isfinite(matched) & (disparity > 0), left.focal_px * calibration.baseline / disparity, np.nan
        )
    points = (left.rays() * depth[..., None]).astype(np.float32)
    on_surface = surface(points, left.focal_px)
    points[on_surface.isolated] = np.nan
    back = left.rotation.astype(np.float32)
    colours = pictures[0] if pictures[0].ndim == 3 else cv2.cvtColor(pictures[0], cv2.COLOR_GRAY2BGR)
    return DenseCloud(
        points @ back, np.ascontiguousarray(colours[..., ::-1]), on_surface.normals @ back, calibration.unit
    )


def _rectified(calibration: Calibration, matches: Matches) -> tuple[_Rectified, _Rectified, int, int]:
    """Both frames rotated so that x runs along the baseline, and z is as close as possible to both views.

    (Fusiello, Trucco & Verri 2000; for baselines in any direction, unlike cv2.stereoRectify's two.) The pictures
    contain all matches, at an unchanged scale. Also returned, within bounds: the least disparity and the number of
    disparities.
    """
    x = calibration.projector_centre / calibration.baseline
    y = np.cross(np.array([0.0, 0.0, 1.0]) + calibration.pose.rotation[2], x)
    y /= np.linalg.norm(y)
    common = np.stack([x, y, np.cross(x, y)])
    met = intersect(matches, calibration)
    points = met.points[met.in_front] @ common.T
    points = points[points[:, 2] > 0]
    rays = [points[:, :2] / points[:, 2:], (points - (calibration.baseline, 0, 0))[:, :2] / points[:, 2:]]
    bounds = [np.percentile(of_photo, [_RAREST, 100 - _RAREST], axis=0) for of_photo in rays]
    spare = _SPARE * max(float(np.ptp(bound, axis=0).max()) for bound in bounds)
    low_y, high_y = min(bound[0, 1] for bound in bounds) - spare, max(bound[1, 1] for bound in bounds) + spare
    width = max(float(np.ptp(bound[:, 0])) for bound in bounds) + 2 * spare
    disparity = np.percentile(rays[0][:, 0] - rays[1][:, 0], [_RAREST, 100 - _RAREST])
    focal = min(
        calibration.camera.focal_px[0],
        _LONGEST_SIDE / max(width, high_y - low_y),
        _MOST_DISPARITIES / np.ptp(disparity),
    )
    size = (int(focal * width) + 1, int(focal * (high_y - low_y)) + 1)
    left, right = (
        _Rectified(turn, focal, np.floor(focal * np.array([bound[0, 0] - spare, low_y])), size)
        for turn, bound in zip((common, calibration.pose.rotate(common)), bounds, strict=True)
    )
    low, high = focal * disparity - left.low[0] + right.low[0]
    least = int(np.floor(low - _SPARE_PX))
    steps = int(np.ceil((high + _SPARE_PX - least) / _DISPARITY_STEP))
    return left, right, least, _DISPARITY_STEP * max(steps, 1)


def _match(left: Image, right: Image, least: int, count: int) -> Floats:
    """Disparities (H, W) in columns, NaN for none."""
    channels = left.shape[2] if left.ndim == 3 else 1
    matcher = cv2.StereoSGBM.create(
        minDisparity=least,
        numDisparities=count,
        blockSize=_BLOCK,
        P1=8 * channels * _BLOCK**2,
        P2=32 * channels * _BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=200,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # The search starts beyond the picture's margin, so a margin is added on that side.
    margin = max(0, least + count)
    padded = [
        cv2.copyMakeBorder(picture, 0, 0, margin, max(0, -least), cv2.BORDER_REPLICATE) for picture in (left, right)
    ]
    disparity = matcher.compute(*padded).astype(np.float64)[:, margin : margin + left.shape[1]] / 16
    empty = left.reshape(*left.shape[:2], -1).max(axis=2) == 0
    return np.where((disparity < least) | empty, np.nan, disparity)
