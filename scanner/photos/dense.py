"""Every pixel of two calibrated photos matched: rectified, then OpenCV's semi-global matching (Hirschmüller 2008)."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import Bools, Floats, Image
from calib.calibration import Calibration
from calib.camera import Intrinsics
from calib.matches import Matches
from calib.triangulation import intersect
from scanner.photos.photo import Photo
from scanner.surface import surface

_LONGEST_SIDE = 1600  # of what is matched: beyond it memory and time grow, and detail hardly does
_FLATTEST = 0.3  # depth of a ray of length 1 in the rectified frame, below which the picture would be stretched too far
_BLOCK = 5
_DISPARITY_STEP = 16  # OpenCV searches whole multiples of so many pixels
_RAREST = 0.5  # per cent of the sparse matches whose disparities the search may miss at either end
_SPARE_PX = 8.0


@dataclass(frozen=True)
class DenseCloud:
    """Points (H, W, 3) in the first photo's frame, on the grid of its rectified picture, NaN where there is none.

    `colours` (H, W, 3) RGB, `normals` (H, W, 3) facing the first photo's place.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8]
    normals: NDArray[np.float32]
    unit: str

    @property
    def there(self) -> Bools:
        """Which pixels have a point, (H, W)."""
        return np.isfinite(self.points[..., 2])


@dataclass(frozen=True)
class _Rectified:
    """A photo in a frame whose x axis is the baseline: `low` (2,) is its first pixel, `focal_px` that of both photos.

    `rotation` (3, 3): from the photo's frame into the common one.
    """

    rotation: Floats
    focal_px: float
    low: Floats
    size: tuple[int, int]

    def rays(self) -> Floats:
        """Of its pixels in the common frame, (H, W, 3) at z = 1."""
        width, height = self.size
        x, y = np.meshgrid(np.arange(width) + self.low[0], np.arange(height) + self.low[1])
        return np.stack([x / self.focal_px, y / self.focal_px, np.ones_like(x)], axis=-1)

    def picture(self, photo: Photo, camera: Intrinsics) -> Image:
        """The photo as it would be in this frame, without its lens."""
        pixels = camera.project(self.rays() @ self.rotation).astype(np.float32)
        outside = np.float32(-1e6)  # where the lens model ends, like what lies outside of the photo
        maps = np.where(np.isfinite(pixels), pixels, outside)
        return cv2.remap(photo.pixels, maps[..., 0], maps[..., 1], cv2.INTER_CUBIC, borderValue=0)


def dense_cloud(first: Photo, second: Photo, calibration: Calibration, matches: Matches) -> DenseCloud:
    """Points of every pixel of the first photo that finds its like in the second.

    `matches` say how far apart that may be. Parts that moved, shine or repeat may be wrong; what the two directions of
    matching disagree on is left out.
    """
    left, right = _rectified(calibration)
    pictures = left.picture(first, calibration.camera), right.picture(second, calibration.projector)
    low, count = _disparities(left, right, calibration, matches)
    found = _match(*pictures, low, count)
    disparity = found + left.low[0] - right.low[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(np.isfinite(found) & (disparity > 0), left.focal_px * calibration.baseline / disparity, np.nan)
    points = (left.rays() * depth[..., None]).astype(np.float32)
    on_surface = surface(points, left.focal_px)
    points[on_surface.isolated] = np.nan
    back = left.rotation.astype(np.float32)
    colours = pictures[0] if pictures[0].ndim == 3 else cv2.cvtColor(pictures[0], cv2.COLOR_GRAY2BGR)
    return DenseCloud(
        points @ back, np.ascontiguousarray(colours[..., ::-1]), on_surface.normals @ back, calibration.unit
    )


def _rectified(calibration: Calibration) -> tuple[_Rectified, _Rectified]:
    """Both photos' frames turned until x runs along the baseline, z staying as near as it can to both views.

    (Fusiello, Trucco & Verri 2000; for baselines in any direction, unlike cv2.stereoRectify's two.)
    """
    x = calibration.projector_centre / calibration.baseline
    ahead = np.array([0.0, 0.0, 1.0]) + calibration.rotation[2]
    y = np.cross(ahead, x)
    y /= np.linalg.norm(y)
    common = np.stack([x, y, np.cross(x, y)])
    camera = calibration.camera
    scale = min(1.0, _LONGEST_SIDE / max(camera.width, camera.height))
    focal = scale * camera.focal_px[0]
    turns = common, common @ calibration.rotation.T
    bounds = [_bounds(device, turn, focal) for device, turn in zip((camera, calibration.projector), turns, strict=True)]
    top = min(low[1] for low, _ in bounds)
    bottom = max(high[1] for _, high in bounds)
    first, second = (
        _Rectified(turn, focal, np.array([low[0], top]), (int(high[0] - low[0]) + 1, int(bottom - top) + 1))
        for turn, (low, high) in zip(turns, bounds, strict=True)
    )
    # Semi-global matching wants two pictures of one size.
    width = max(first.size[0], second.size[0])
    size = (width, first.size[1])
    return (
        _Rectified(first.rotation, focal, first.low, size),
        _Rectified(second.rotation, focal, second.low, size),
    )


def _bounds(device: Intrinsics, turn: Floats, focal_px: float) -> tuple[Floats, Floats]:
    """Least and greatest whole pixel coordinates (2,) of a photo's rim in the turned frame."""
    x, y = np.linspace(0, device.width - 1, 33), np.linspace(0, device.height - 1, 33)
    rim = np.concatenate(
        [np.stack([x, np.full(33, edge)], axis=1) for edge in (0.0, device.height - 1.0)]
        + [np.stack([np.full(33, edge), y], axis=1) for edge in (0.0, device.width - 1.0)]
    )
    rays = device.unproject(rim) @ turn.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    flat = focal_px * rays[:, :2] / np.maximum(rays[:, 2:], _FLATTEST)
    return np.floor(np.nanmin(flat, axis=0)), np.ceil(np.nanmax(flat, axis=0))


def _disparities(left: _Rectified, right: _Rectified, calibration: Calibration, matches: Matches) -> tuple[int, int]:
    """Least disparity between the two pictures' columns, and how many to search."""
    met = intersect(matches, calibration)
    depth = (met.points[met.in_front] @ left.rotation.T)[:, 2]
    disparity = left.focal_px * calibration.baseline / depth[depth > 0] - left.low[0] + right.low[0]
    low, high = np.percentile(disparity, [_RAREST, 100 - _RAREST])
    least = int(np.floor(low - _SPARE_PX))
    steps = int(np.ceil((high + _SPARE_PX - least) / _DISPARITY_STEP))
    return least, _DISPARITY_STEP * max(steps, 1)


def _match(left: Image, right: Image, least: int, count: int) -> Floats:
    """Disparities (H, W) in columns, NaN where there is none."""
    channels = left.shape[2] if left.ndim == 3 else 1
    matcher = cv2.StereoSGBM_create(
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
    # The search starts beyond the picture's margin: room for it on the side from which it comes.
    margin = max(0, least + count)
    padded = [cv2.copyMakeBorder(picture, 0, 0, margin, max(0, -least), cv2.BORDER_REPLICATE) for picture in (left, right)]
    found = matcher.compute(*padded).astype(np.float64)[:, margin : margin + left.shape[1]] / 16
    empty = left.reshape(*left.shape[:2], -1).max(axis=2) == 0
    return np.where((found < least) | empty, np.nan, found)
