"""Pictures of a point cloud without a graphics card: orthographic views, splatted into a depth buffer."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.arrays import Floats
from calib.calibration import Calibration
from calib.camera import Intrinsics
from scanner.cloud import Cloud
from scanner.merged_cloud import MergedCloud

RGBA = NDArray[np.uint8]
RGB = tuple[int, int, int]
Ints64 = NDArray[np.int64]

_SUPERSAMPLING = 2
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
    there = cloud.there
    normals = cloud.normals[there]
    facing = -(normals @ view.axes[2])
    front = facing > 0
    seen = cloud.points[there][front].astype(np.float64) @ view.axes.T
    drawn = [wireframe.segments @ view.axes.T for wireframe in wireframes]
    low, high = _bounds(seen, drawn)
    scale = _SUPERSAMPLING * min(size[0] / (high - low)[0], size[1] / (high - low)[1])
    shape = tuple(int(np.ceil(extent * scale)) for extent in (high - low)[::-1])
    pixels = (seen[:, :2] - low) * scale
    inside = np.all((pixels >= 0) & (pixels < shape[::-1]), axis=1)
    colours = _shaded(cloud.colours[there][front], normals[front], view)
    picture = _filled(_splat(pixels[inside], seen[inside, 2], colours[inside], (shape[0], shape[1])))
    for wireframe, segments in zip(wireframes, drawn, strict=True):
        ends = np.rint((segments[..., :2] - low) * scale).astype(np.int32)
        width = _LINE_WIDTH_PX * _SUPERSAMPLING
        cv2.polylines(picture, list(ends), False, (*wireframe.colour, 255), width, cv2.LINE_AA)
    return _shrunk(picture)


def _bounds(seen: Floats, drawn: list[Floats]) -> tuple[Floats, Floats]:
    """Corners of the picture in the view's plane, (2,) each: all but stray points, all lines, and a margin."""
    ends = [np.percentile(seen[:, :2], (0.2, 99.8), axis=0)] if len(seen) else [np.zeros((1, 2)), np.ones((1, 2))]
    ends += [segments.reshape(-1, 3)[:, :2] for segments in drawn]
    everything = np.concatenate(ends)
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = _MARGIN * float(np.max(high - low)) + np.finfo(np.float64).tiny
    return low - margin, high + margin


def _shaded(colours: NDArray[np.uint8], normals: NDArray[np.float32], view: View) -> NDArray[np.uint8]:
    """Colours stretched to the full range, under a lamp above the viewer's left shoulder."""
    right, down, forward = view.axes
    lamp = -forward - 0.5 * right - 0.6 * down
    light = 0.45 + 0.55 * np.clip(normals @ (lamp / np.linalg.norm(lamp)), 0, 1)
    white = max(1.0, float(np.percentile(colours, 99))) if len(colours) else 1.0
    stretched = np.clip(colours / white, 0, 1) ** 0.8
    return np.asarray(np.rint(255 * np.clip(1.05 * stretched * light[:, None], 0, 1)), dtype=np.uint8)


def _splat(pixels: Floats, depth: Floats, colours: NDArray[np.uint8], shape: tuple[int, int]) -> RGBA:
    """The nearest point at each pixel, each point drawn as a square large enough to close the gaps around it."""
    picture = np.zeros((*shape, 4), dtype=np.uint8)
    nearest = np.full(shape[0] * shape[1], np.inf)
    flat = picture.reshape(-1, 4)
    side = _splat_sides(pixels, shape)
    corner = np.floor(pixels - (side[:, None] - 1) / 2).astype(np.int64)
    for dx, dy in np.ndindex(_LARGEST_SPLAT, _LARGEST_SPLAT):
        large = np.flatnonzero(side > max(dx, dy))
        at = corner[large] + np.array([dx, dy])
        inside = np.all((at >= 0) & (at < shape[::-1]), axis=1)
        drawn, index = large[inside], (at[:, 1] * shape[1] + at[:, 0])[inside]
        np.minimum.at(nearest, index, depth[drawn])
        visible = depth[drawn] == nearest[index]
        flat[index[visible], :3] = colours[drawn[visible]]
        flat[index[visible], 3] = 255
    return picture


def _splat_sides(pixels: Floats, shape: tuple[int, int]) -> Ints64:
    """Side of each point's square: the spacing of the points around it, in pixels."""
    columns = shape[1] // _DENSITY_CELL + 1
    cell = (pixels // _DENSITY_CELL).astype(np.int64) @ np.array([1, columns])
    spacing = _DENSITY_CELL / np.sqrt(np.bincount(cell)[cell]) if len(cell) else np.zeros(0)
    return np.clip(np.ceil(1.2 * spacing), 1, _LARGEST_SPLAT).astype(np.int64)


def _filled(picture: RGBA) -> RGBA:
    """Transparent pixels that are mostly surrounded by opaque ones take the mean of those."""
    for _ in range(_FILL_PASSES):
        opaque = (picture[..., 3:] > 0).astype(np.float32)
        around = cv2.boxFilter(
            np.concatenate([picture[..., :3] * opaque, opaque], axis=-1), -1, (3, 3), normalize=False
        )
        gap = (opaque[..., 0] == 0) & (around[..., 3] >= _SURROUNDED)
        picture[gap, :3] = np.rint(around[gap, :3] / around[gap, 3:])
        picture[gap, 3] = 255
    return picture


def _shrunk(picture: RGBA) -> RGBA:
    """Average over the supersampled pixels, weighted by opacity so that no black creeps in at the edges."""
    size = (picture.shape[1] // _SUPERSAMPLING, picture.shape[0] // _SUPERSAMPLING)
    alpha = picture[..., 3:].astype(np.float32) / 255
    weighted = np.concatenate([picture[..., :3] * alpha, alpha], axis=-1)
    small = cv2.resize(weighted, size, interpolation=cv2.INTER_AREA)
    opaque = small[..., 3:]
    colour = small[..., :3] / np.maximum(opaque, 1e-6)
    return np.asarray(np.rint(np.concatenate([colour, 255 * opaque], axis=-1)), dtype=np.uint8)
