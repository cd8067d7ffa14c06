"""The files of a mapping: mapping.glb, mapping.yaml, and five maps of each projector.

Float maps are TIFF: OpenCV writes it in every build, EXR only in some. All places are as in the GLB: in metres,
x right, y up, z backward. Pixels that light nothing are 0 in every map.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats
from scanner.exporting.formats import Request
from scanner.exporting.glb import GlbCamera, Piece, write_pieces
from scanner.exporting.mapping.blend import blend_weights
from scanner.exporting.mapping.content import Content, content_on, largest_wall
from scanner.exporting.mapping.lens_shift import for_programs
from scanner.exporting.mapping.projector_view import ProjectorView, projector_views
from scanner.exporting.mapping.scene import Scene, read_scene
from scanner.exporting.triangles import Y_UP_FROM_CAMERA
from scanner.exporting.units import in_metres
from scanner.io import block_yaml, new_files, png_of, refuse_existing

SCENE_FILE, LISTING_FILE = "mapping.glb", "mapping.yaml"
_NEAR, _FAR = 0.1, 2.0  # clipping planes, relative to the nearest and the farthest depth
_MOST = 65535
_HOW = {
    "axes": "of all places, in metres: x right, y up, z backward; those of mapping.glb",
    "depth": "metres along the projector's axis, float",
    "position": "x, y, z of what a pixel lights as red, green, blue, float",
    "stmap": "where in the content a pixel looks, float: red from left, green from bottom, 0 to 1 over the whole "
    "picture from edge to edge; blue: 1 where there is content",
    "warp": "the same, of 16 bits",
    "blend": "what to multiply the content with, of 16 bits: weight^(1/gamma); weights at one point add up to 1",
}


def export(request: Request) -> list[str]:
    """Write everything into a folder. Raises InputError and OSError."""
    refuse_existing(request.out / LISTING_FILE, overwrite=request.overwrite)
    scene = read_scene(request.result)
    metres, remarks = in_metres(scene.mesh.unit, scene.baseline)
    views = projector_views(scene)
    eye = None if request.eye is None else np.array(request.eye) * Y_UP_FROM_CAMERA / metres
    content = content_on(largest_wall(scene.mesh), views, eye)
    at = [content.coordinates(view) for view in views]
    weights = blend_weights(views, [np.isfinite(each[..., 0]) for each in at])
    files: dict[str, bytes] = {}
    listed = []
    cameras = []
    for view, where, weight in zip(views, at, weights, strict=True):
        device = view.projector
        maps = _maps(view, where, weight, metres, request.gamma)
        files |= {f"{device.name}-{name}": data for name, data in maps.items()}
        near, far = _reach(view)
        shift = for_programs(device.intrinsics, metres * near, metres * far)
        cameras.append(GlbCamera(device.name, device.intrinsics, device.place, metres * near, metres * far, shift))
        listed.append(_entry(view, metres, shift, [f"{device.name}-{name}" for name in maps]))
    listing = {
        "maps": _HOW,
        "gamma": request.gamma,
        "content": _content_entry(content, metres),
        "projectors": listed,
    }
    files[LISTING_FILE] = block_yaml(listing).encode()
    with new_files(request.out, [SCENE_FILE, *files], overwrite=request.overwrite) as (glb, *paths):
        write_pieces(glb, [Piece(scene.mesh)], metres, cameras)
        for path, data in zip(paths, files.values(), strict=True):
            path.write_bytes(data)
    return [*_summary(scene, content, metres, at), *remarks]


def _maps(view: ProjectorView, at: Floats, weight: Floats, metres: float, gamma: float) -> dict[str, bytes]:
    mask = np.isfinite(at[..., :1])
    warp = np.concatenate([np.nan_to_num(at), mask], axis=-1)
    return {
        "depth.tiff": _tiff(metres * view.depth),
        "position.tiff": _tiff(metres * view.points * Y_UP_FROM_CAMERA),
        "stmap.tiff": _tiff(warp),
        "warp.png": png_of(_whole(warp)[..., ::-1]),
        "blend.png": png_of(_whole(weight ** (1 / gamma))),
    }


def _tiff(values: Floats) -> bytes:
    """Float, channels as red, green and blue."""
    image = np.nan_to_num(values).astype(np.float32)
    _, data = cv2.imencode(".tiff", np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image)
    return data.tobytes()


def _whole(values: Floats) -> NDArray[np.uint16]:
    """0 to 1 as 16 bits."""
    whole: NDArray[np.uint16] = np.rint(_MOST * values.clip(0, 1)).astype(np.uint16)
    return whole


def _reach(view: ProjectorView) -> tuple[float, float]:
    if not view.there.any():
        return 0.1, 100.0
    return _NEAR * float(np.nanmin(view.depth)), _FAR * float(np.nanmax(view.depth))


def _entry(view: ProjectorView, metres: float, shift: dict[str, Any], files: list[str]) -> dict[str, Any]:
    device, place = view.projector.intrinsics, view.projector.place
    turned = Y_UP_FROM_CAMERA[:, None] * place.rotation * Y_UP_FROM_CAMERA
    return {
        "name": view.projector.name,
        "files": files,
        "width": device.width,
        "height": device.height,
        "focal_px": list(device.focal_px),
        "principal_point_px": list(device.principal_point_px),
        "distortion": list(device.distortion),
        "rotation": turned.tolist(),
        "position": (metres * Y_UP_FROM_CAMERA * place.translation).tolist(),
        "programs": shift,
    }


def _content_entry(content: Content, metres: float) -> dict[str, Any]:
    def vector(value: Floats, factor: float = 1.0) -> list[float]:
        found: list[float] = (factor * Y_UP_FROM_CAMERA * value).tolist()
        return found

    return {
        "width": content.size.width,
        "height": content.size.height,
        "extent_m": [metres * side for side in content.extent],
        "lower_left": vector(content.origin, metres),
        "right": vector(content.right),
        "up": vector(content.up),
        "eye": None if content.eye is None else vector(content.eye, metres),
    }


def _summary(scene: Scene, content: Content, metres: float, at: list[Floats]) -> list[str]:
    width, height = (f"{metres * side:.2f}" for side in content.extent)
    count = len(scene.projectors)
    cameras = f"{count} projectors as cameras" if count > 1 else "1 projector as a camera"
    shares = (
        f"{each.name} {np.mean(np.isfinite(where[..., 0])):.0%}"
        for each, where in zip(scene.projectors, at, strict=True)
    )
    return [
        f"{cameras}, {len(scene.mesh.triangles):,} triangles",
        f"Content: {content.size} pixels on {width} m × {height} m of the largest wall",
        f"Pixels that show some of it: {', '.join(shares)}",
    ]
