"""Points of one station's drawing of a plane, found again in another's.

They are followed as of Lucas and Kanade ("An iterative image registration technique", 1981; pyramids by Bouguet, 2000),
forth and back, light that falls differently being taken out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.estimation import ROBUST_SIGMAS, block_inflation
from calib.geometry import project, tangent_basis, unproject
from calib.numerics import MEDIAN_LENGTH, Floats, Image, median
from calib.registration import log_brightness, rectify_texture
from calib.rooms.factors import Track
from calib.rooms.room import Room

_MOST, _FEWEST = 200, 8
_LARGEST_PX = 1000  # pixels along a side of a drawing
_SAMPLED = 150  # samples per row that determine a plane's extent
_LEAST_COMMON = 900  # common pixels of both drawings
_WINDOW_PX, _LEVELS = 21, 3
_QUALITY, _SPACING_PX = 0.02, 7
_FORWARD_BACKWARD_PX = 0.3  # largest forward-backward error of a tracked point
_LEAST_CORRELATION = 0.8  # least correlation of the surroundings of a point in both drawings
_SHADING_PX = 12.0
_OUTLIER_SIGMAS = 4.0
_LEAST_SIGMA_PX = 0.1  # camera pixels: smallest stated sigma of a point


@dataclass(frozen=True, eq=False)
class LabelledPicture:
    """A station's picture (H, W), of logarithms, and the plane's label of each of its pixels (H, W), −1 for none."""

    light: NDArray[np.uint8]
    labels: NDArray[np.int32]

    @classmethod
    def of(cls, picture: Image, labels: NDArray[np.int32]) -> "LabelledPicture":
        """From the picture (H, W) or (H, W, 3) of the lit scene."""
        return cls(log_brightness(picture), labels)


def find_tracks(
    sights: Sequence[LabelledPicture | None], plane_of: Sequence[Sequence[int]], room: Room
) -> tuple[Track, ...]:
    """Between all stations with a picture, on the room's planes that `plane_of` says of each station's labels."""
    tracks = []
    on = [
        None if sight is None else np.array([*planes, -1], np.int32)[sight.labels]
        for sight, planes in zip(sights, plane_of, strict=True)
    ]
    for first, second in combinations(range(len(sights)), 2):
        first_sight, second_sight, first_planes, second_planes = sights[first], sights[second], on[first], on[second]
        if first_sight is None or second_sight is None or first_planes is None or second_planes is None:
            continue
        for plane in sorted({*plane_of[first]} & {*plane_of[second]} - {-1}):
            track = _followed(
                (first, second), plane, (first_sight.light, second_sight.light), (first_planes, second_planes), room
            )
            if track is not None:
                tracks.append(track)
    return tuple(tracks)


def _followed(
    stations: tuple[int, int],
    plane: int,
    lights: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    planes: tuple[NDArray[np.int32], NDArray[np.int32]],
    room: Room,
) -> Track | None:
    """The points of a plane that are in two stations' drawings, as these stand now; None if there are too few.

    `planes`: of each station's pixels (H, W), as of the room.
    """
    axes, low, size, shape = _common(stations, plane, planes, room)
    if min(shape) < _WINDOW_PX:
        return None
    normal, offset = room.planes[plane].normal, room.planes[plane].offset
    u, v = np.meshgrid(low[0] + size * np.arange(shape[0]), low[1] + size * np.arange(shape[1]))
    front = np.stack([u, v], axis=-1) @ axes.T + offset * normal
    drawings: list[tuple[NDArray[np.uint8], NDArray[np.uint8]]] = []
    inside = np.full(u.shape, 255, np.uint8)
    for station, light, on in zip(stations, lights, planes, strict=True):
        pixels = _seen_at(room, station, front.reshape(-1, 3)).reshape(*u.shape, 2)
        drawings.append(rectify_texture(light, on == plane, pixels))
        inside &= drawings[-1][1]
    if np.count_nonzero(inside) < _LEAST_COMMON:
        return None
    flat = [_without_shading(*drawing) for drawing in drawings]
    here, there = _forward_backward(flat[0], flat[1], inside)
    if len(here) < _FEWEST:
        return None
    first_px, second_px = (
        _seen_at(room, station, (low + size * drawing_px) @ axes.T + offset * normal)
        for station, drawing_px in zip(stations, (here, there), strict=True)
    )
    return _without_outliers(Track(*stations, plane, (first_px, second_px), np.ones(len(here))), room)


def _forward_backward(
    first: NDArray[np.uint8], second: NDArray[np.uint8], inside: NDArray[np.uint8]
) -> tuple[Floats, Floats]:
    """Points (N, 2) of a drawing, and their positions in the other one, checked by tracking back."""
    corners: Any = cv2.goodFeaturesToTrack(first, _MOST, _QUALITY, _SPACING_PX, mask=inside)
    if corners is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    follow: Any = partial(cv2.calcOpticalFlowPyrLK, winSize=(_WINDOW_PX, _WINDOW_PX), maxLevel=_LEVELS)
    moved, tracked, _ = follow(first, second, corners, None)
    back, tracked_back, _ = follow(second, first, moved, None)
    here, there, returned = (corner_px.reshape(-1, 2).astype(np.float64) for corner_px in (corners, moved, back))
    good = (
        (tracked.ravel() > 0)
        & (tracked_back.ravel() > 0)
        & (np.linalg.norm(returned - here, axis=1) < _FORWARD_BACKWARD_PX)
    )
    good[good] = _correlation((first, second), here[good], there[good]) > _LEAST_CORRELATION
    return here[good], there[good]


def _common(
    stations: tuple[int, int], plane: int, planes: tuple[NDArray[np.int32], NDArray[np.int32]], room: Room
) -> tuple[Floats, Floats, float, tuple[int, int]]:
    """A grid on a plane over what both stations see of it: axes (3, 2), lowest corner (2,), pixel, width and height."""
    wall = room.planes[plane]
    axes, lows, highs, sizes = tangent_basis(wall.normal), [], [], []
    for station, on in zip(stations, planes, strict=True):
        step = max(1, on.shape[1] // _SAMPLED)
        row, column = np.nonzero(on[::step, ::step] == plane)
        if len(row) == 0:
            return axes, np.zeros(2), 1.0, (0, 0)
        place = room.places[station]
        rays, _ = unproject(room.rig.camera, step * np.stack([column, row], axis=1).astype(np.float64))
        turned = place.rotate(rays)
        depth = wall.depths(turned, place.translation)
        at = (depth[:, None] * turned + place.translation) @ axes
        lows.append(np.percentile(at, 1, axis=0))
        highs.append(np.percentile(at, 99, axis=0))
        sizes.append(float(np.median(depth)) / float(room.rig.camera[0]))
    low, high = np.max(lows, axis=0), np.min(highs, axis=0)
    size = max(*sizes, float(np.max(high - low)) / _LARGEST_PX)
    width, height = np.maximum(np.floor((high - low) / size), 0).astype(int).tolist()
    return axes, low, size, (width, height)


def _seen_at(room: Room, station: int, points: Floats) -> Floats:
    """Camera pixels (N, 2) of points (N, 3) of the room, NaN behind the camera."""
    place = room.places[station]
    own = place.undo(points)
    pixels, _, _ = project(room.rig.camera, own)
    return np.where(own[:, 2:] > 0, pixels, np.nan)


def _without_shading(drawing: NDArray[np.uint8], inside: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Without what changes slowly, about a middle grey."""
    weight = (inside > 0).astype(np.float32)
    light = drawing.astype(np.float32) * weight
    blurred = cv2.GaussianBlur(light, (0, 0), _SHADING_PX) / np.maximum(
        cv2.GaussianBlur(weight, (0, 0), _SHADING_PX), 1e-3
    )
    return np.clip(np.rint(128 + 2 * (light - blurred) * weight), 0, 255).astype(np.uint8)


def _correlation(flat: Sequence[NDArray[np.uint8]], here: Floats, there: Floats) -> Floats:
    """Correlation (N,) of the surroundings of points (N, 2) in two drawings."""
    correlations = np.zeros(len(here))
    for i, both in enumerate(zip(here, there, strict=True)):
        first_window, second_window = (
            cv2.getRectSubPix(drawing, (_WINDOW_PX, _WINDOW_PX), (float(x), float(y))).astype(np.float64)
            for drawing, (x, y) in zip(flat, both, strict=True)
        )
        first_window, second_window = first_window - first_window.mean(), second_window - second_window.mean()
        correlations[i] = np.sum(first_window * second_window) / max(
            float(np.sqrt(np.sum(first_window**2) * np.sum(second_window**2))), 1e-9
        )
    return correlations


def _without_outliers(track: Track, room: Room) -> Track | None:
    """With variances by how the points scatter about their common shift, and without those that are far off it."""
    off, _, by_pixels = track.differences(room)
    track = replace(track, variance=_LEAST_SIGMA_PX**2 * np.sum(by_pixels**2, axis=(1, 2)) / 2)
    residual = off - np.median(off, axis=0)
    size = np.linalg.norm(residual, axis=1) / np.sqrt(track.variance)
    larger = max(1.0, median(size) / MEDIAN_LENGTH)
    good = size < _OUTLIER_SIGMAS * larger
    if np.count_nonzero(good) < _FEWEST:
        return None
    kept = replace(track, variance=larger**2 * track.variance)[good]
    relative = np.clip(residual[good] / np.sqrt(kept.variance)[:, None], -ROBUST_SIGMAS, ROBUST_SIGMAS)
    alike = np.mean([block_inflation(kept.pixels[0], column) for column in relative.T])
    return replace(kept, variance=float(alike) * kept.variance)
