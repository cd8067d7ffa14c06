"""Triangulates matches to an organised point cloud, with at most one point for each camera pixel."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Matches
from calib.numerics import Bools, Image, in_slices
from calib.pointcloud.normals import scattered_surface, surface
from calib.pointcloud.pixel_grid import organise

_NO_TEXTURE_GREY = 200
_WHITE_PERCENTILE = 99.9
_STRIP_ROWS = 64


@dataclass(frozen=True)
class CloudStatistics:
    """Counts of matches: `matched` is the sum of `kept` and all that were dropped.

    `outside_image`: off the camera's grid; `behind`: not in front of both devices; `disagreeing`: the rays miss each
    other by more than `limit_px`; `shared_pixel`: another match of the same camera pixel fitted better; `isolated`: no
    neighbours on a common surface. `calibration_px` and `decoder_px`: root mean squares of the two parts of the
    rays' misses, the smooth one and the rest, in projector pixels.
    """

    matched: int
    kept: int
    outside_image: int
    behind: int
    disagreeing: int
    shared_pixel: int
    isolated: int
    limit_px: float
    calibration_px: float
    decoder_px: float


@dataclass(frozen=True)
class Cloud:
    """Points on the camera's pixel grid, in the camera's frame (x right, y down, z forward).

    `points` (H, W, 3) in `unit`, NaN where there is none; `colours` (H, W, 3) RGB; `normals` (H, W, 3), of unit length
    and facing the camera; `residual_px` (H, W): signed distance of the projector pixel from the camera pixel's epipolar
    line, also where the point was dropped for it, NaN where there was no match; `match` (H, W): the number of the match
    that each point was triangulated from, of no meaning where there is none.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8]
    normals: NDArray[np.float32]
    residual_px: NDArray[np.float32]
    match: NDArray[np.int32]
    unit: str
    statistics: CloudStatistics

    @cached_property
    def there(self) -> Bools:
        """Which pixels have a point, (H, W)."""
        return np.isfinite(self.points[..., 2])


def build_cloud(matches: Matches, texture: Image | None, calibration: Calibration, *, scattered: bool = False) -> Cloud:
    """Triangulate every match, drop those that are not points of a surface, add colours and normals.

    `texture`: the camera's image of the lit scene, (H, W) grey or (H, W, 3) BGR; without it the cloud is grey.
    `scattered`: matches are sparse, so points without neighbours are kept.

    Raises ValueError if the texture's size is not the camera's.
    """
    height, width = calibration.camera.height, calibration.camera.width
    if texture is not None and texture.shape[:2] != (height, width):
        size = f"{texture.shape[1]} × {texture.shape[0]}"
        raise ValueError(f"the texture must have the camera's size {width} × {height}, found {size}")
    organised = organise(matches, calibration)
    points = organised.points
    on_surface = (
        scattered_surface(points) if scattered else surface(points, float(np.mean(calibration.camera.focal_px)))
    )
    isolated = np.flatnonzero(on_surface.isolated)
    points.reshape(-1, 3)[isolated] = np.nan
    on_surface.normals.reshape(-1, 3)[isolated] = np.nan
    dropped = {
        "outside_image": organised.outside_image,
        "behind": organised.behind,
        "disagreeing": organised.disagreeing,
        "shared_pixel": organised.shared_pixel,
        "isolated": len(isolated),
    }
    there = np.empty((height, width), np.bool_)
    in_slices(height, _STRIP_ROWS, lambda rows: np.isfinite(points[rows, :, 2], out=there[rows]))
    return Cloud(
        points=points,
        colours=colours_of(texture, there),
        normals=on_surface.normals,
        residual_px=organised.residual_px,
        match=organised.match,
        unit=calibration.unit,
        statistics=CloudStatistics(
            matched=len(matches),
            kept=len(matches) - sum(dropped.values()),
            **dropped,
            limit_px=organised.misses.limit_px,
            calibration_px=organised.trend_px,
            decoder_px=organised.misses.noise_px,
        ),
    )


def colours_of(texture: Image | None, there: Bools) -> NDArray[np.uint8]:
    """RGB (H, W, 3) of a camera's image, (H, W) or (H, W, 3) BGR; black where there is no point. 16-bit images are
    scaled to their 99.9 % percentile.
    """
    if texture is None:
        bright = np.full(there.shape, _NO_TEXTURE_GREY, dtype=np.uint8)
    elif texture.dtype == np.uint16:
        top = max(1.0, float(np.percentile(texture[there], _WHITE_PERCENTILE))) if there.any() else 1.0
        levels = np.arange(1 << 16) * (255.0 / top)
        bright = np.rint(np.minimum(levels, 255.0)).astype(np.uint8)[texture]
    else:
        bright = texture.astype(np.uint8, copy=False)
    order, rgb = cv2.COLOR_BGR2RGB if bright.ndim == 3 else cv2.COLOR_GRAY2RGB, np.zeros((*there.shape, 3), np.uint8)
    mask = there.view(np.uint8)
    in_slices(len(rgb), _STRIP_ROWS, lambda rows: cv2.copyTo(cv2.cvtColor(bright[rows], order), mask[rows], rgb[rows]))
    return rgb
