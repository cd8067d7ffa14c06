"""Pictures of a point cloud without a graphics card: orthographic views, splatted into a depth buffer."""

from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Intrinsics
from calib.numerics import Floats, Ints
from calib.pointcloud import Cloud, MergedCloud
from scanner.rendering.splatting import RGBA, Floats32, facing, filled, halved, shaded_colours, splatted

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
    seen, index = facing(
        points[None].astype(np.float32), normals[None].astype(np.float32), view.axes.astype(np.float32), 1, step
    )
    low, high = _bounds(seen, [])
    scale = _SUPERSAMPLING * min(size[0] / (high - low)[0], size[1] / (high - low)[1])
    height, width = (int(np.ceil(extent * scale)) for extent in (high - low)[::-1])
    pixels = (seen - np.append(low, 0).astype(np.float32)) * np.float32(scale)
    opaque = np.full((len(index), 4), 255, np.uint8)
    opaque[:, :3] = colours[index]
    picture = splatted(pixels, opaque, height, width)
    for _ in range(_FILL_PASSES):
        picture = filled(picture)
    return halved(picture)
