"""Pictures of a point cloud without a graphics card: orthographic views, splatted into a depth buffer."""

from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import Floats, Ints
from calib.calibration import Calibration
from calib.camera import Intrinsics
from scanner.cloud import Cloud
from scanner.merged_cloud import MergedCloud

RGBA = NDArray[np.uint8]
RGB = tuple[int, int, int]
Floats32 = NDArray[np.float32]

_SUPERSAMPLING = 2
# Of the picture as it is shown. More would hide each other.
_POINTS_PER_PIXEL = 1.0
_LARGEST_SPLAT = 6
_DENSITY_CELL = 12
_MARGIN = 0.04
_LINE_WIDTH_PX = 2
_FILL_PASSES = 3
_SURROUNDED = 5  # of eight neighbours


@dataclass(frozen=True)
class View:
    """An orthographic view; `axes` (3, 3): the picture's right, down and forward as unit rows, in the cloud's frame."""

    axes: Floats


@dataclass(frozen=True)
class _Points:
    """`points` (N, 3), `normals` (N, 3) facing the camera, `colours` (N, 3) RGB."""

    points: Floats32
    normals: Floats32
    colours: NDArray[np.uint8]


@dataclass(frozen=True)
class Wireframe:
    """Line segments (N, 2, 3) in the cloud's frame, and their colour."""

    segments: Floats
    colour: RGB


def view_along(forward: Floats, up: Floats) -> View:
    """The view along `forward` (3,) in which `up` (3,) points to the top of the picture."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, up)
    x = x / np.linalg.norm(x)
    return View(np.stack([x, np.cross(z, x), z]))


def standard_views(forward: Floats, up: Floats) -> dict[str, View]:
    """Oblique, top and front views of what lies along `forward` (3,), with `up` (3,) at the top."""
    up = up / np.linalg.norm(up)
    level = forward - (forward @ up) * up
    level = level / np.linalg.norm(level)
    aside = np.cross(level, up)
    return {
        "oblique": view_along(level - 0.55 * up - 0.55 * aside, up),
        "top": view_along(-up, level),
        "front": view_along(level, up),
    }


def frustum(device: Intrinsics, length: float) -> Floats:
    """The pyramid that a device at the origin sees, (8, 2, 3): four edges of `length` and its far rim."""
    right, bottom = device.width - 1, device.height - 1
    corners = device.unproject(np.array([[0, 0], [right, 0], [right, bottom], [0, bottom]], dtype=np.float64))
    corners *= length / np.linalg.norm(corners, axis=1, keepdims=True)
    edges = np.stack([np.zeros_like(corners), corners], axis=1)
    rim = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return np.concatenate([edges, rim])


def rig_frusta(calibration: Calibration, length: float, camera_colour: RGB, projector_colour: RGB) -> list[Wireframe]:
    """Wireframes of both devices in the camera's frame."""
    projector = (frustum(calibration.projector, length) - calibration.translation) @ calibration.rotation
    return [Wireframe(frustum(calibration.camera, length), camera_colour), Wireframe(projector, projector_colour)]


def render(cloud: Cloud | MergedCloud, view: View, size: tuple[int, int], wireframes: list[Wireframe]) -> RGBA:
    """A picture (height, width, 4) of at most `size` = (width, height), transparent where nothing is.

    Surfaces seen from behind are left out, so that one looks into a room through its walls.
    """
    points, axes = _thinned(cloud, size), view.axes.astype(np.float32)
    front = np.flatnonzero(points.normals @ axes[2] < 0)
    # From far to near: what is drawn later hides what was drawn before.
    front = front[np.argsort(points.points.take(front, axis=0) @ -axes[2])]
    seen = points.points.take(front, axis=0) @ axes.T
    drawn = [wireframe.segments @ view.axes.T for wireframe in wireframes]
    low, high = _bounds(seen, drawn)
    scale = _SUPERSAMPLING * min(size[0] / (high - low)[0], size[1] / (high - low)[1])
    shape = tuple(int(np.ceil(extent * scale)) for extent in (high - low)[::-1])
    pixels = (seen[:, :2] - low.astype(np.float32)) * np.float32(scale)
    x, y = pixels.T
    inside = np.flatnonzero((x >= 0) & (y >= 0) & (x < shape[1]) & (y < shape[0]))
    pixels, front = pixels.take(inside, axis=0), front[inside]
    colours = _shaded(points.colours.take(front, axis=0), points.normals.take(front, axis=0), view)
    picture = _filled(_splat(pixels, colours, (shape[0], shape[1])))
    for wireframe, segments in zip(wireframes, drawn, strict=True):
        ends = np.rint((segments[..., :2] - low) * scale).astype(np.int32)
        width = _LINE_WIDTH_PX * _SUPERSAMPLING
        cv2.polylines(picture, list(ends), False, (*wireframe.colour, 255), width)
    return _shrunk(picture)


def _thinned(cloud: Cloud | MergedCloud, size: tuple[int, int]) -> _Points:
    """As many points as a picture of `size` = (width, height) can show, evenly out of all."""
    there = cloud.there
    most = _POINTS_PER_PIXEL * size[0] * size[1]
    excess = max(1.0, np.count_nonzero(there) / most)
    chosen = (slice(None, None, ceil(excess ** (1 / there.ndim))),) * there.ndim
    there = there[chosen]
    pixels = np.flatnonzero(there)
    return _Points(
        cloud.points[chosen].reshape(-1, 3).take(pixels, axis=0),
        cloud.normals[chosen].reshape(-1, 3).take(pixels, axis=0),
        cloud.colours[chosen].reshape(-1, 3).take(pixels, axis=0),
    )


def _bounds(seen: Floats32, drawn: list[Floats]) -> tuple[Floats, Floats]:
    """Corners of the picture in the view's plane, (2,) each: all but stray points, all lines, and a margin."""
    ends = [np.array([[0.0, 0.0], [1.0, 1.0]])]
    if len(seen):
        ends = [np.asarray(np.percentile(seen[:, :2], (0.2, 99.8), axis=0), np.float64)]
    ends += [segments.reshape(-1, 3)[:, :2] for segments in drawn]
    everything = np.concatenate(ends)
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = _MARGIN * float(np.max(high - low)) + np.finfo(np.float64).tiny
    return low - margin, high + margin


def _shaded(colours: NDArray[np.uint8], normals: NDArray[np.float32], view: View) -> NDArray[np.uint8]:
    """Colours stretched to the full range, under a lamp above the viewer's left shoulder."""
    right, down, forward = view.axes
    lamp = -forward - 0.5 * right - 0.6 * down
    lamp_direction = (lamp / np.linalg.norm(lamp)).astype(np.float32)
    light = np.float32(0.45) + np.float32(0.55) * np.clip(normals @ lamp_direction, 0, 1)
    cumulated = np.cumsum(np.bincount(colours.ravel(), minlength=256))
    white = max(1, int(np.searchsorted(cumulated, 0.99 * cumulated[-1])))
    stretched = (1.05 * 255 * np.clip(np.arange(256) / white, 0, 1) ** 0.8).astype(np.float32)[colours]
    stretched *= light[:, None]
    return np.asarray(np.rint(np.minimum(stretched, np.float32(255))), dtype=np.uint8)


def _splat(pixels: Floats32, colours: NDArray[np.uint8], shape: tuple[int, int]) -> RGBA:
    """The last point at each pixel, each point drawn as a square large enough to close the gaps around it."""
    side = _splat_sides(pixels, shape)
    corner = np.floor(pixels - (side[:, None] - 1) / np.float32(2)).astype(np.int32) + _LARGEST_SPLAT
    padded = shape[0] + 2 * _LARGEST_SPLAT, shape[1] + 2 * _LARGEST_SPLAT
    # Numbers of points, from 1; single precision counts as far as 2²⁴, and dilates fastest.
    last = np.zeros(padded, np.float32)
    for width in range(1, _LARGEST_SPLAT + 1):
        drawn = np.flatnonzero(side == width)
        corners = np.zeros(padded, np.float32)
        # Of several values for one place numpy keeps the last.
        corners[corner[drawn, 1], corner[drawn, 0]] = drawn + 1
        squares = cv2.dilate(corners, np.ones((width, width), np.uint8), anchor=(width - 1, width - 1))
        np.maximum(last, squares, out=last)
    inner = slice(_LARGEST_SPLAT, -_LARGEST_SPLAT)
    rgba = np.zeros((len(colours) + 1, 4), np.uint8)
    rgba[1:, :3], rgba[1:, 3] = colours, 255
    picture: RGBA = rgba[last[inner, inner].astype(np.int32)]
    return picture


def _splat_sides(pixels: Floats32, shape: tuple[int, int]) -> Ints:
    """Side of each point's square: the spacing of the points around it, in pixels."""
    columns = shape[1] // _DENSITY_CELL + 1
    column, row = (pixels.T / np.float32(_DENSITY_CELL)).astype(np.int32)
    cell = row * np.int32(columns) + column
    count = np.bincount(cell)
    spacing = np.zeros(len(count))
    spacing[count > 0] = _DENSITY_CELL / np.sqrt(count[count > 0])
    sides: Ints = np.clip(np.ceil(1.2 * spacing), 1, _LARGEST_SPLAT).astype(np.int32)
    of_points: Ints = sides[cell]
    return of_points


def _filled(picture: RGBA) -> RGBA:
    """Transparent pixels, which are black, take the mean of the opaque ones that they are mostly surrounded by."""
    for _ in range(_FILL_PASSES):
        around = cv2.boxFilter(picture, cv2.CV_16U, (3, 3), normalize=False)
        gap = np.nonzero((picture[..., 3] == 0) & (around[..., 3] >= 255 * _SURROUNDED))
        filling = around[gap].astype(np.float32)
        picture[gap] = np.rint(255 * filling / filling[:, 3:])
    return picture


def _shrunk(picture: RGBA) -> RGBA:
    """Average over the supersampled pixels.

    Transparent pixels are black, so that colours are means times opacity, and are divided by it.
    """
    size = (picture.shape[1] // _SUPERSAMPLING, picture.shape[0] // _SUPERSAMPLING)
    small = np.asarray(cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
    edge = np.nonzero((small[..., 3] > 0) & (small[..., 3] < 255))
    mixed = small[edge]
    mixed[:, :3] *= 255 / mixed[:, 3:]
    small[edge] = mixed
    return np.asarray(np.rint(small), np.uint8)
