"""Pictures of a point cloud without a graphics card: orthographic views, splatted into a depth buffer.

The loops behind pictures of point clouds: points that face the viewer, drawn as squares into a depth buffer.
"""

from dataclasses import dataclass
from math import ceil
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Intrinsics
from calib.numerics import Floats, Ints, compiled
from calib.pointcloud import Cloud, MergedCloud

RGBA: TypeAlias = NDArray[np.uint8]
Floats32: TypeAlias = NDArray[np.float32]

_LARGEST_SPLAT = 6
_DENSITY_CELL = 12
_SPLAT_OF_SPACING = 1.2
_SURROUNDED = 5  # of eight neighbours
_OPAQUE = 255
RGB = tuple[int, int, int]

_SUPERSAMPLING = 2
# Points per pixel of the shown picture; more would hide each other.
_POINTS_PER_PIXEL = 1.0
_POINT = 1e-9  # extent of what has none, as a share of its distance from the origin
_MARGIN = 0.04
_LINE_WIDTH_PX = 2
_FILL_PASSES = 3
# This many points determine the extent and brightness of the cloud.
_SAMPLE, _COUNTED_ROWS = 50_000, 8


@compiled
def facing(
    points: Floats32, normals: Floats32, axes: Floats32, row_step: int, column_step: int
) -> tuple[Floats32, Ints]:
    """Select from `points` (H, W, 3), NaN for none, subsampled by rows and columns, those whose `normals` face the
    viewer.

    Returns them (N, 3) in the viewer's frame, whose `axes` (3, 3) are unit rows: right, down, forward; and their
    indices into the H · W points, (N,).
    """
    rows = (points.shape[0] - 1) // row_step + 1
    columns = (points.shape[1] - 1) // column_step + 1
    colours = np.empty((rows * columns, 3), np.float32)
    index = np.empty(rows * columns, np.int64)
    count = 0
    for row in range(0, points.shape[0], row_step):
        for column in range(0, points.shape[1], column_step):
            point, normal = points[row, column], normals[row, column]
            away = axes[2, 0] * normal[0] + axes[2, 1] * normal[1] + axes[2, 2] * normal[2]
            if np.isfinite(point[2]) and away < 0:
                for axis in range(3):
                    colours[count, axis] = (
                        axes[axis, 0] * point[0] + axes[axis, 1] * point[1] + axes[axis, 2] * point[2]
                    )
                index[count] = row * points.shape[1] + column
                count += 1
    return colours[:count], index[:count]


@compiled
def shaded_colours(
    colours: NDArray[np.uint8], normals: Floats32, index: Ints, brightness: Floats32, lamp: Floats32
) -> NDArray[np.uint8]:
    """Opaque RGBA (N, 4) of the points `index` (N,) under a `lamp` (3,), a unit vector towards it.

    `colours` (M, 3) and `normals` (M, 3) of all points; `brightness` (256,): table of a colour in full light.
    """
    shaded = np.full((len(index), 4), _OPAQUE, np.uint8)
    for i in range(len(index)):
        normal = normals[index[i]]
        slant = max(np.float32(0), normal[0] * lamp[0] + normal[1] * lamp[1] + normal[2] * lamp[2])
        light = np.float32(0.45) + np.float32(0.55) * min(np.float32(1), slant)
        for channel in range(3):
            bright = light * brightness[colours[index[i], channel]]
            shaded[i, channel] = np.uint8(min(np.float32(255), bright) + np.float32(0.5))
    return shaded


def splatted(pixels: Floats32, colours: RGBA, height: int, width: int) -> RGBA:
    """A picture (height, width, 4) of points (N, 3) at column and row, and a depth, with their `colours` (N, 4).

    Each is drawn as a square that is large enough to close the gaps around it, by the spacing of the points there. The
    nearest hides the others.
    """
    return _splatted(pixels, colours.view(np.uint32)[:, 0], height, width).view(np.uint8).reshape(height, width, 4)


@compiled
def _splatted(pixels: Floats32, colours: NDArray[np.uint32], height: int, width: int) -> NDArray[np.uint32]:
    sides = np.zeros((height // _DENSITY_CELL + 1, width // _DENSITY_CELL + 1), np.int64)
    for i in range(len(pixels)):
        x, y = pixels[i, 0], pixels[i, 1]
        if 0 <= x < width and 0 <= y < height:
            sides[int(y) // _DENSITY_CELL, int(x) // _DENSITY_CELL] += 1
    for row in range(sides.shape[0]):
        for column in range(sides.shape[1]):
            spacing = _DENSITY_CELL / np.sqrt(max(sides[row, column], 1))
            sides[row, column] = min(max(int(np.ceil(_SPLAT_OF_SPACING * spacing)), 1), _LARGEST_SPLAT)

    nearest = np.full((height, width), np.inf, np.float32)
    picture = np.zeros((height, width), np.uint32)
    for i in range(len(pixels)):
        x, y, depth = pixels[i]
        if not (0 <= x < width and 0 <= y < height):
            continue
        side = sides[int(y) // _DENSITY_CELL, int(x) // _DENSITY_CELL]
        left, top = int(np.floor(x - 0.5 * (side - 1))), int(np.floor(y - 0.5 * (side - 1)))
        for row in range(max(top, 0), min(top + side, height)):
            for column in range(max(left, 0), min(left + side, width)):
                if depth < nearest[row, column]:
                    nearest[row, column] = depth
                    picture[row, column] = colours[i]
    return picture


@compiled
def filled(picture: RGBA) -> RGBA:
    """Transparent pixels take the mean of the opaque ones that they are mostly surrounded by; the border stays."""
    result = picture.copy()
    for row in range(1, picture.shape[0] - 1):
        for column in range(1, picture.shape[1] - 1):
            if picture[row, column, 3]:
                continue
            beside = picture[row, column - 1, 3] | picture[row, column + 1, 3]
            # Without these four, at most four of the eight are opaque.
            if not (beside | picture[row - 1, column, 3] | picture[row + 1, column, 3]):
                continue
            count, red, green, blue = 0, 0, 0, 0
            for y in range(row - 1, row + 2):
                for x in range(column - 1, column + 2):
                    if picture[y, x, 3]:
                        count += 1
                        red += picture[y, x, 0]
                        green += picture[y, x, 1]
                        blue += picture[y, x, 2]
            if count >= _SURROUNDED:
                result[row, column, 0] = (red + count // 2) // count
                result[row, column, 1] = (green + count // 2) // count
                result[row, column, 2] = (blue + count // 2) // count
                result[row, column, 3] = _OPAQUE
    return result


@compiled
def halved(picture: RGBA) -> RGBA:
    """Squares of two by two pixels become one: colours are the means of the opaque ones, opacity is their share."""
    result = np.zeros((picture.shape[0] // 2, picture.shape[1] // 2, 4), np.uint8)
    for row in range(result.shape[0]):
        for column in range(result.shape[1]):
            count, red, green, blue = 0, 0, 0, 0
            for y in range(2 * row, 2 * row + 2):
                for x in range(2 * column, 2 * column + 2):
                    if picture[y, x, 3]:
                        count += 1
                        red += picture[y, x, 0]
                        green += picture[y, x, 1]
                        blue += picture[y, x, 2]
            if count:
                result[row, column, 0] = (red + count // 2) // count
                result[row, column, 1] = (green + count // 2) // count
                result[row, column, 2] = (blue + count // 2) // count
                result[row, column, 3] = (_OPAQUE * count + 2) // 4
    return result


@dataclass(frozen=True)
class OrthographicView:
    """An orthographic view; `axes` (3, 3): the picture's right, down and forward as unit rows, in the cloud's frame."""

    axes: Floats


@dataclass(frozen=True)
class Wireframe:
    """Line segments (N, 2, 3) in the cloud's frame, and their colour."""

    segments: Floats
    colour: RGB


def view_along(forward: Floats, up: Floats) -> OrthographicView:
    """The view along `forward` (3,) in which `up` (3,) points to the top of the picture."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, up)
    x = x / np.linalg.norm(x)
    return OrthographicView(np.stack([x, np.cross(z, x), z]))


def standard_views(forward: Floats, up: Floats) -> dict[str, OrthographicView]:
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
    return frustum_lines(corners)


def frustum_lines(corners: Floats) -> Floats:
    """The eight edges (8, 2, 3) of the pyramid from the origin to `corners` (4, 3)."""
    edges = np.stack([np.zeros_like(corners), corners], axis=1)
    return np.concatenate([edges, np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)])


def frustum_of_projector(calibration: Calibration, length: float) -> Floats:
    """Return the frustum that the projector lights, (8, 2, 3), in the camera's frame."""
    return calibration.pose.undo(frustum(calibration.projector, length))


def rig_frusta(calibration: Calibration, length: float, camera_colour: RGB, projector_colour: RGB) -> list[Wireframe]:
    """Wireframes of both devices in the camera's frame."""
    projector = Wireframe(frustum_of_projector(calibration, length), projector_colour)
    return [Wireframe(frustum(calibration.camera, length), camera_colour), projector]


def render(
    cloud: Cloud | MergedCloud, view: OrthographicView, size: tuple[int, int], wireframes: list[Wireframe]
) -> RGBA:
    """A picture (height, width, 4) of at most `size` = (width, height), transparent where empty.

    Surfaces seen from behind are not drawn, so that walls do not hide the inside of a room.
    """
    facing, index = _facing(cloud, view, _POINTS_PER_PIXEL * size[0] * size[1])
    drawn = [wireframe.segments @ view.axes.T for wireframe in wireframes]
    low, high = _bounds(facing, drawn)
    scale = _SUPERSAMPLING * min(size[0] / (high - low)[0], size[1] / (high - low)[1])
    height, width = (int(np.ceil(extent * scale)) for extent in (high - low)[::-1])
    pixels = (facing - np.append(low, 0).astype(np.float32)) * np.float32(scale)
    picture = splatted(pixels, _shaded(cloud, index, view), height, width)
    for _ in range(_FILL_PASSES):
        picture = filled(picture)
    for wireframe, segments in zip(wireframes, drawn, strict=True):
        ends = np.rint((segments[..., :2] - low) * scale).astype(np.int32)
        line_width = _LINE_WIDTH_PX * _SUPERSAMPLING
        cv2.polylines(picture, list(ends), False, (*wireframe.colour, 255), line_width)
    return halved(picture)


def _facing(cloud: Cloud | MergedCloud, view: OrthographicView, most: float) -> tuple[Floats32, Ints]:
    """Points (N, 3) in the view's frame, `most` of them evenly out of all, and which of the cloud's they are (N,)."""
    is_image = cloud.points.ndim == 3
    points, normals = (values if is_image else values[None] for values in (cloud.points, cloud.normals))
    # A subset of the rows suffices to count the points.
    total = _COUNTED_ROWS * np.count_nonzero(np.isfinite(points[::_COUNTED_ROWS, :, 2])) if is_image else len(points[0])
    step = ceil(max(1.0, total / most) ** (1 / cloud.points[..., 0].ndim))
    row_step = step if is_image else 1
    return facing(points, normals, view.axes.astype(np.float32), row_step, step)


def _bounds(facing: Floats32, drawn: list[Floats]) -> tuple[Floats, Floats]:
    """Corners of the picture in the view's plane, (2,) each: without outliers, with all lines and a margin."""
    ends = [np.array([[0.0, 0.0], [1.0, 1.0]])]
    if len(facing):
        some = facing[:: max(1, len(facing) // _SAMPLE), :2]
        ends = [np.asarray(np.percentile(some, (0.2, 99.8), axis=0), np.float64)]
    ends += [segments.reshape(-1, 3)[:, :2] for segments in drawn]
    everything = np.concatenate(ends)
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = float(np.max(high - low))
    if size <= _POINT * float(np.max(np.abs(everything))):  # all of it is at one place
        size = max(float(np.max(np.abs(everything))), 1.0)
    margin = _MARGIN * size
    return low - margin, high + margin


def _shaded(cloud: Cloud | MergedCloud, index: Ints, view: OrthographicView) -> NDArray[np.uint8]:
    """Colours (N, 3) of some points, stretched to the full range, under a lamp above the viewer's left shoulder."""
    colours, normals = cloud.colours.reshape(-1, 3), cloud.normals.reshape(-1, 3)
    right, down, forward = view.axes
    lamp = -forward - 0.5 * right - 0.6 * down
    some = colours[index[:: max(1, len(index) // _SAMPLE)]]
    cumulated = np.cumsum(np.bincount(some.ravel(), minlength=256))
    white = max(1, int(np.searchsorted(cumulated, 0.99 * cumulated[-1])))
    brightness = (1.05 * 255 * np.clip(np.arange(256) / white, 0, 1) ** 0.8).astype(np.float32)
    return shaded_colours(colours, normals, index, brightness, (lamp / np.linalg.norm(lamp)).astype(np.float32))


def splatted_view(
    points: Floats, normals: Floats, colours: NDArray[np.uint8], view: OrthographicView, size: tuple[int, int]
) -> RGBA:
    """A picture of points (N, 3) in just their colours (N, 3), without light, so that a legend is true of them; else as
    of `render`.
    """
    step = max(1, len(points) // int(2 * size[0] * size[1]))
    view_points, index = facing(
        points[None].astype(np.float32), normals[None].astype(np.float32), view.axes.astype(np.float32), 1, step
    )
    low, high = _bounds(view_points, [])
    scale = _SUPERSAMPLING * min(size[0] / (high - low)[0], size[1] / (high - low)[1])
    height, width = (int(np.ceil(extent * scale)) for extent in (high - low)[::-1])
    pixels = (view_points - np.append(low, 0).astype(np.float32)) * np.float32(scale)
    opaque = np.full((len(index), 4), 255, np.uint8)
    opaque[:, :3] = colours[index]
    picture = splatted(pixels, opaque, height, width)
    for _ in range(_FILL_PASSES):
        picture = filled(picture)
    return halved(picture)
