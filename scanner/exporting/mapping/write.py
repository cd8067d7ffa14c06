"""The files of a mapping: mapping.glb, mapping.yaml, and five maps of each projector.

Float maps are TIFF without compression, which noise would defeat and every program reads. All places are as in the GLB:
in metres, x right, y up, z backward. Pixels that light nothing are 0 in every map.

A projector as the virtual camera of other programs, which have no lens distortion but can shift their lens.

Let (u, v) be the principal point from the upper left corner of the image in pixels, half a pixel more than here, W × H
the image, (f_x, f_y) the focal lengths. Where the sensor is S = 36 mm wide, the lens has f_x S / W millimetres.

Blender shifts in units of the image's width where the sensor fit is horizontal: `BKE_camera_params_compute_viewplane`
adds shift · W to both sides of the view plane, so shift_x = (W/2 − u)/W and shift_y = (v − H/2) f_x / (f_y W). Its
pixels are f_x / f_y as high as they are wide.

Unity's `Camera.lensShift` is in units of the sensor's size along each axis ("relative to the sensor size"):
x = (W/2 − u)/W and y = (v − H/2)/H, with a sensor of S × S H f_x / (f_y W) and no gate fit.

Unreal's nDisplay has the projection policy `manual` with a frustum of four angles in degrees, negative to the left and
to the bottom: AngleL = −atan(u / f_x), AngleR = atan((W − u)/f_x), AngleT = atan(v / f_y), AngleB = −atan((H − v)/f_y).

TouchDesigner's Camera COMP takes a custom 4 × 4 matrix (Projection: Custom Projection Matrix) for column vectors, whose
camera looks along −z with y up, and depth from 0 to 1 as in Vulkan.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from math import atan, degrees
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics
from calib.numerics import Bools, Floats
from scanner.exporting.formats import ExportRequest
from scanner.exporting.glb import GlbCamera, Piece, write_pieces
from scanner.exporting.mapping.blend import LitRegion, distance_from_edge, summed_squares, weights
from scanner.exporting.mapping.content import Content, content_on
from scanner.exporting.mapping.projector_view import Numbers, ProjectorView, view_surface
from scanner.exporting.mapping.scene import MappedScene, WallView, largest_wall, read_scene
from scanner.exporting.triangles import Y_UP_FROM_CAMERA
from scanner.exporting.units import in_metres, noted
from scanner.io import (
    PngFile,
    PngRows,
    StoredDevice,
    block_yaml,
    by_rows,
    new_files,
    refuse_existing,
    require_memory,
    require_space,
    scratch_rows,
    tiff_rows,
)

_SENSOR_MM = 36.0
SCENE_FILE, LISTING_FILE = "mapping.glb", "mapping.yaml"
_MAPS = ("depth.tiff", "position.tiff", "stmap.tiff", "warp.png", "blend.png")
_NEAR, _FAR = 0.1, 2.0  # clipping planes, relative to the nearest and the farthest depth
_MOST = 65535
_BYTES_PER_PIXEL = 50  # of all files of a projector, and of scratch
_MEMORY_PER_PIXEL, _MEMORY = 14, 300_000_000  # of one projector's image, and of everything else
_HOW = {
    "axes": "of all places, in metres: x right, y up, z backward; those of mapping.glb",
    "depth": "metres along the projector's axis, float",
    "position": "x, y, z of what a pixel lights as red, green, blue, float",
    "stmap": "where in the content a pixel looks, float: red from left, green from bottom, 0 to 1 over the whole "
    "picture from edge to edge; blue: 1 where there is content",
    "warp": "the same, of 16 bits",
    "blend": "what to multiply the content with, of 16 bits: weight^(1/gamma); weights at one point add up to 1",
}


def for_programs(device: Intrinsics, near: float, far: float) -> dict[str, Any]:
    """What to enter in each program; `near` and `far` of the clipping planes, in metres."""
    (fx, fy), (width, height) = device.focal_px, device.size
    u, v = (value + 0.5 for value in device.principal_point_px)
    lens_mm, aspect = fx * _SENSOR_MM / width, fx / fy
    across, up = (width / 2 - u) / width, (v - height / 2) / height
    depth = far / (near - far)
    return {
        "blender": {
            "sensor_fit": "HORIZONTAL",
            "sensor_width": _SENSOR_MM,
            "lens": lens_mm,
            "shift_x": across,
            "shift_y": up * height * aspect / width,
            "pixel_aspect_x": max(1.0, 1 / aspect),
            "pixel_aspect_y": max(1.0, aspect),
            "resolution": [width, height],
        },
        "unity": {
            "sensorSize": [_SENSOR_MM, _SENSOR_MM * height * aspect / width],
            "focalLength": lens_mm,
            "lensShift": [across, up],
            "gateFit": "None",
        },
        "unreal_ndisplay_manual": {
            "AngleL": -degrees(atan(u / fx)),
            "AngleR": degrees(atan((width - u) / fx)),
            "AngleT": degrees(atan(v / fy)),
            "AngleB": -degrees(atan((height - v) / fy)),
        },
        "touchdesigner_projection_matrix": [
            [2 * fx / width, 0.0, 2 * across, 0.0],
            [0.0, 2 * fy / height, 2 * up, 0.0],
            [0.0, 0.0, depth, depth * near],
            [0.0, 0.0, -1.0, 0.0],
        ],
    }


def export(request: ExportRequest) -> list[str]:
    """Write everything into a folder. Raises InputError and OSError."""
    refuse_existing(request.out / LISTING_FILE, overwrite=request.overwrite)
    scene = read_scene(request.result, request.capture)
    _require_room(scene.projectors, request.out)
    metres, findings = in_metres(scene.mesh.unit, scene.baseline)
    eye = None if request.eye is None else np.array(request.eye) * Y_UP_FROM_CAMERA / metres
    viewpoint = WallView(largest_wall(scene.mesh), eye)
    viewpoint.refuse_behind()
    names = [f"{projector.name}-{name}" for projector in scene.projectors for name in _MAPS]
    with new_files(request.out, [SCENE_FILE, LISTING_FILE, *names], overwrite=request.overwrite) as paths:
        glb, listing, *maps = paths
        maps_of = [dict(zip(_MAPS, maps[start:], strict=False)) for start in range(0, len(maps), len(_MAPS))]
        content, views, shares = _write_maps(scene, viewpoint, metres, request.gamma, maps_of)
        cameras = [_camera(view, metres) for view in views]
        write_pieces(glb, [Piece(scene.mesh)], metres, cameras)
        entry = {
            "maps": _HOW,
            "gamma": request.gamma,
            "content": _content_entry(content, metres),
            "projectors": [_entry(camera, metres) for camera in cameras],
        }
        listing.write_text(block_yaml(entry), encoding="utf-8")
    return [*_summary(scene, content, metres, shares), *noted(findings)]


def _require_room(projectors: Sequence[StoredDevice], out: Path) -> None:
    """Raise InputError or StorageError if the maps do not fit into the memory or on the disk."""
    pixels = [projector.intrinsics.width * projector.intrinsics.height for projector in projectors]
    what = f"maps for {len(pixels)} projectors of up to {max(pixels) / 1e6:.1f} megapixels"
    require_memory(_MEMORY + _MEMORY_PER_PIXEL * max(pixels), what, "export fewer or smaller projectors")
    require_space(out.parent, len(_MAPS) * len(pixels), _BYTES_PER_PIXEL * sum(pixels), what)


def _write_maps(
    scene: MappedScene, viewpoint: WallView, metres: float, gamma: float, maps_of: Sequence[Mapping[str, Path]]
) -> tuple[Content, list[ProjectorView], list[float]]:
    """Write `maps_of` each projector; returns the content, and the share of each one's pixels that show some of it."""
    to_file = metres * Y_UP_FROM_CAMERA
    scratch = maps_of[0][_MAPS[0]].parent
    views, regions, shares = list[ProjectorView](), list[LitRegion](), list[float]()
    with ExitStack() as stack:
        for projector, maps in zip(scene.projectors, maps_of, strict=True):
            shape = projector.intrinsics.height, projector.intrinsics.width
            depth = stack.enter_context(tiff_rows(maps["depth.tiff"], shape))
            position = stack.enter_context(tiff_rows(maps["position.tiff"], (*shape, 3)))
            on_wall = stack.enter_context(scratch_rows(scratch, (*shape, 2)))
            views.append(view_surface(projector, scene.mesh, viewpoint, to_file, depth, position, on_wall))
        content = content_on(viewpoint, [view.part for view in views])
        for view, maps in zip(views, maps_of, strict=True):
            region = LitRegion(view, stack.enter_context(scratch_rows(scratch, view.depth.shape)))
            places_shown = _write_places(view, content, maps)
            region.distance.write_all(distance_from_edge(view, places_shown))
            regions.append(region)
            shares.append(float(places_shown.mean()))
        for region, maps in zip(regions, maps_of, strict=True):
            _write_blend(region, summed_squares(region, regions, to_file), gamma, maps["blend.png"])
    return content, views, shares


def _write_places(view: ProjectorView, content: Content, maps: Mapping[str, Path]) -> Bools:
    """Write where in the content each pixel looks; returns where there is content (H, W)."""
    height, width = view.depth.shape
    lit = np.zeros((height, width), np.bool_)
    with tiff_rows(maps["stmap.tiff"], (height, width, 3)) as stmap, maps["warp.png"].open("wb") as file:
        warp = PngFile(file, (height, width, 3), np.dtype(np.uint16), is_computed=True)

        def place(rows: slice) -> PngRows:
            places = content.coordinates(view.on_wall.read(rows))
            lit[rows] = places[..., 2] > 0
            stmap.write(rows, places)
            return warp.compressed(_whole(places)[..., ::-1], is_last=rows.stop == height)

        for compressed in by_rows(lit.shape, place):
            warp.append(compressed)
    return lit


def _write_blend(region: LitRegion, total: Numbers, gamma: float, path: Path) -> None:
    with path.open("wb") as file:
        blend = PngFile(file, total.shape, np.dtype(np.uint16), is_computed=True)

        def weigh(rows: slice) -> PngRows:
            factor = _whole(weights(region, total, rows) ** np.float32(1 / gamma))
            return blend.compressed(factor, is_last=rows.stop == len(total))

        for compressed in by_rows(total.shape, weigh):
            blend.append(compressed)


def _whole(values: Numbers) -> NDArray[np.uint16]:
    """0 to 1 as 16 bits."""
    whole: NDArray[np.uint16] = np.rint(_MOST * values).astype(np.uint16)
    return whole


def _camera(view: ProjectorView, metres: float) -> GlbCamera:
    device = view.projector
    near, far = (_NEAR * view.nearest, _FAR * view.farthest) if view.farthest > 0 else (0.1 * metres, 100.0 * metres)
    shift = for_programs(device.intrinsics, near, far)
    return GlbCamera(device.name, device.intrinsics, device.place, near, far, shift)


def _entry(camera: GlbCamera, metres: float) -> dict[str, Any]:
    device, place = camera.device, camera.place
    turned = Y_UP_FROM_CAMERA[:, None] * place.rotation * Y_UP_FROM_CAMERA
    return {
        "name": camera.name,
        "files": [f"{camera.name}-{name}" for name in _MAPS],
        "width": device.width,
        "height": device.height,
        "focal_px": list(device.focal_px),
        "principal_point_px": list(device.principal_point_px),
        "distortion": list(device.distortion),
        "rotation": turned.tolist(),
        "position": (metres * Y_UP_FROM_CAMERA * place.translation).tolist(),
        "programs": dict(camera.extras),
    }


def _content_entry(content: Content, metres: float) -> dict[str, Any]:
    def vector(value: Floats, factor: float = 1.0) -> list[float]:
        y_up: list[float] = (factor * Y_UP_FROM_CAMERA * value).tolist()
        return y_up

    eye = content.viewpoint.eye
    return {
        "width": content.size.width,
        "height": content.size.height,
        "extent_m": [metres * side for side in content.extent],
        "lower_left": vector(content.origin, metres),
        "right": vector(content.viewpoint.wall.axes[:, 0]),
        "up": vector(content.viewpoint.wall.axes[:, 1]),
        "eye": None if eye is None else vector(eye, metres),
    }


def _summary(scene: MappedScene, content: Content, metres: float, shares: Sequence[float]) -> list[str]:
    width, height = (f"{metres * side:.2f}" for side in content.extent)
    count = len(scene.projectors)
    cameras = f"{count} projectors as cameras" if count > 1 else "1 projector as a camera"
    share_texts = (f"{device.name} {share:.0%}" for device, share in zip(scene.projectors, shares, strict=True))
    return [
        f"{cameras}, {len(scene.mesh.triangles):,} triangles",
        f"Content: {content.size} pixels on {width} m × {height} m of the largest wall",
        f"Pixels that show some of it: {', '.join(share_texts)}",
    ]
