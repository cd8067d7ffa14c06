"""Matches and a calibration → an organised point cloud: one point for every camera pixel that earned one."""

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import Bools, Image, Ints
from calib.calibration import Calibration
from calib.matches import Matches
from calib.pieces import by_columns, in_pieces
from calib.triangulation import intersect_rays
from scanner.agreement import Misses, expected_misses
from scanner.surface import scattered_surface, surface

_NO_TEXTURE_GREY = 200
_WHITE_PERCENTILE = 99.9
_SAMPLE = 100_000


@dataclass(frozen=True)
class CloudStatistics:
    """What became of the matches: `matched` is the sum of `kept` and everything that was dropped.

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
    line, also where the point was dropped for it, NaN where there was no match.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8]
    normals: NDArray[np.float32]
    residual_px: NDArray[np.float32]
    unit: str
    statistics: CloudStatistics

    @property
    def there(self) -> Bools:
        """Which pixels have a point, (H, W)."""
        return np.isfinite(self.points[..., 2])


def build_cloud(matches: Matches, texture: Image | None, calibration: Calibration, *, scattered: bool = False) -> Cloud:
    """Triangulate every match, drop those that cannot be points of a surface, add colours and normals.

    `texture`: the camera's image of the lit scene, (H, W) grey or (H, W, 3) BGR; without it the cloud is grey.
    `scattered`: the matches are few and far between, so none is dropped for having no neighbours.

    Raises ValueError if the texture's size is not the camera's.
    """
    height, width = calibration.camera.height, calibration.camera.width
    if texture is not None and texture.shape[:2] != (height, width):
        found = f"{texture.shape[1]} × {texture.shape[0]}"
        raise ValueError(f"the texture must have the camera's size {width} × {height}, found {found}")
    met = _triangulate(matches, calibration)
    chosen = _best_per_pixel(met)
    points = np.full((height, width, 3), np.nan, dtype=np.float32)
    points.reshape(-1, 3)[met.pixel[chosen]] = met.points[chosen]
    on_surface = (
        scattered_surface(points) if scattered else surface(points, float(np.mean(calibration.camera.focal_px)))
    )
    isolated = np.nonzero(on_surface.isolated)
    points[isolated] = np.nan
    on_surface.normals[isolated] = np.nan
    in_front, agreeing = (int(np.count_nonzero(met.fate >= fate)) for fate in (_Fate.DISAGREEING, _Fate.AGREEING))
    outside = int(np.count_nonzero(met.fate == _Fate.OUTSIDE))
    return Cloud(
        points=points,
        colours=_colours(texture, np.isfinite(points[..., 2])),
        normals=on_surface.normals,
        residual_px=_residual_map(met, (height, width)),
        unit=calibration.unit,
        statistics=CloudStatistics(
            matched=len(matches),
            kept=len(chosen) - len(isolated[0]),
            outside_image=outside,
            behind=len(matches) - outside - in_front,
            disagreeing=in_front - agreeing,
            shared_pixel=agreeing - len(chosen),
            isolated=len(isolated[0]),
            limit_px=met.misses.limit_px,
            calibration_px=float(np.sqrt(met.squared_trend / max(agreeing, 1))),
            decoder_px=met.misses.noise_px,
        ),
    )


class _Fate(IntEnum):
    """What became of a match so far."""

    OUTSIDE = 0
    BEHIND = 1
    DISAGREEING = 2
    AGREEING = 3


@dataclass(frozen=True)
class _Met:
    """Of each match: number of its `pixel` (N,), `points` (N, 3), `residual_px` (N,), `fate` (N,) as of `_Fate`.

    `misses`: what was expected; `squared_trend`: sum over those that agree, px².
    """

    pixel: NDArray[np.int32]
    points: NDArray[np.float32]
    residual_px: NDArray[np.float32]
    fate: NDArray[np.uint8]
    misses: Misses
    squared_trend: float


def _triangulate(matches: Matches, calibration: Calibration) -> _Met:
    """Intersect all rays and judge their misses, piece by piece, for what lies between would fill the memory."""
    count, size = len(matches), (calibration.camera.width, calibration.camera.height)
    pixel, fate = np.empty(count, np.int32), np.empty(count, np.uint8)
    points, residual_px = np.empty((count, 3), np.float32), np.empty(count, np.float32)
    misses = _expected_misses(matches, calibration)

    def fill(at: slice) -> float:
        camera_px = by_columns(matches.camera_px[at])
        met = intersect_rays(camera_px, matches.projector_px[at], calibration)
        column, row = np.rint(camera_px.T)
        inside = (column >= 0) & (row >= 0) & (column < size[0]) & (row < size[1])
        usable = inside & met.in_front
        trend_px = misses.trend_px(camera_px, met.foot_px, calibration)
        agrees = misses.agree(met.residual_px, trend_px) & usable
        pixel[at] = np.where(inside, row * size[0] + column, 0)
        points[at], residual_px[at] = met.points, met.residual_px
        fate[at] = inside.astype(np.uint8) + usable + agrees
        return float(np.sum(trend_px * trend_px, where=agrees))

    squared_trend = sum(in_pieces(count, fill))
    return _Met(pixel, points, residual_px, fate, misses, squared_trend)


def _expected_misses(matches: Matches, calibration: Calibration) -> Misses:
    """From a sample: of millions of matches, so many say as much."""
    step = max(1, len(matches) // _SAMPLE)
    camera_px = by_columns(matches.camera_px[::step])
    met = intersect_rays(camera_px, matches.projector_px[::step], calibration)
    there = met.in_front
    return expected_misses(camera_px[there], met.foot_px[there], met.residual_px[there], calibration)


def _best_per_pixel(met: _Met) -> Ints:
    """Which of the matches to keep: of those that agree, the best of each pixel."""
    candidates = np.flatnonzero(met.fate == _Fate.AGREEING)
    pixel = met.pixel[candidates]
    # Nearly always matches come row by row, one for each pixel.
    if np.all(pixel[1:] > pixel[:-1]):
        return candidates
    order = candidates[np.lexsort((np.abs(met.residual_px[candidates]), pixel))]
    first = np.unique(met.pixel[order], return_index=True)[1]
    return order[first]


def _residual_map(met: _Met, shape: tuple[int, int]) -> NDArray[np.float32]:
    grid = np.full(shape[0] * shape[1], np.nan, dtype=np.float32)
    usable = np.flatnonzero(met.fate >= _Fate.DISAGREEING)
    grid[met.pixel[usable]] = met.residual_px[usable]
    return grid.reshape(shape)


def _colours(texture: Image | None, there: Bools) -> NDArray[np.uint8]:
    """RGB (H, W, 3), black where there is no point; 16-bit images are scaled to their brightest level, glints apart."""
    if texture is None:
        bright = np.full(there.shape, _NO_TEXTURE_GREY, dtype=np.uint8)
    elif texture.dtype == np.uint16:
        top = max(1.0, float(np.percentile(texture[there], _WHITE_PERCENTILE))) if there.any() else 1.0
        bright = np.rint(np.minimum(texture * (255.0 / top), 255.0)).astype(np.uint8)
    else:
        bright = texture.astype(np.uint8, copy=False)
    rgb = cv2.cvtColor(bright, cv2.COLOR_BGR2RGB if bright.ndim == 3 else cv2.COLOR_GRAY2RGB)
    rgb[~there] = 0
    return np.asarray(rgb, np.uint8)
