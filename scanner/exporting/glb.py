"""A mesh as binary glTF 2.0: one node, one mesh, one buffer.

glTF is right-handed, y up, in metres, a camera looks along −z, and vertex colours are linear, pictures sRGB. The
colours are the camera's, lit by the projector, so materials are unlit and show them as they are.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics, Pose
from calib.numerics import Floats, is_far
from scanner.exporting.triangles import Y_UP_FROM_CAMERA, Mesh, linear_light

# Numbers of the glTF 2.0 specification.
_MAGIC, _VERSION = 0x46546C67, 2
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED_SHORT, _UNSIGNED_INT = 5126, 5123, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_TRIANGLES = 4
_LINEAR, _LINEAR_MIPMAPS, _CLAMPED = 9729, 9987, 33071


@dataclass(frozen=True, eq=False)
class Piece:
    """Triangles of one material: with a picture, in which each point has its position (N, 2) relative to width and
    height from the upper left corner; or, if `jpeg` is empty, with colours of the points.
    """

    mesh: Mesh
    places: Floats | None = None
    jpeg: bytes = b""


def write_glb(path: Path, mesh: Mesh, metres_per_unit: float) -> None:
    """Write positions in metres, normals, colours and triangles. Raises OSError.

    Positions far from the origin, as in the coordinates of a survey, are relative to the node's translation.
    """
    middle = np.median(mesh.points, axis=0) if is_far(mesh.points) else np.zeros(3)
    _write(path, [Piece(replace(mesh, points=mesh.points - middle))], metres_per_unit, (), middle)


@dataclass(frozen=True, eq=False)
class GlbCamera:
    """A device as a camera with its pose, X = rotation X_device + translation, in the frame and unit of the mesh.

    glTF's cameras have no lens shift: this one faces along the device's axis with its focal length, and the rest is in
    `extras`. `near`, `far`: clipping planes.
    """

    name: str
    device: Intrinsics
    place: Pose
    near: float
    far: float
    extras: Mapping[str, object]


def write_pieces(
    path: Path, pieces: Sequence[Piece], metres_per_unit: float, cameras: Sequence[GlbCamera] = ()
) -> None:
    """The same of a mesh in pieces, with their pictures in the file, and with cameras. Raises OSError."""
    _write(path, pieces, metres_per_unit, cameras, np.zeros(3))


def _write(
    path: Path, pieces: Sequence[Piece], metres_per_unit: float, cameras: Sequence[GlbCamera], middle: Floats
) -> None:
    binary = _Binary()
    primitives: list[dict[str, object]] = []
    materials: list[dict[str, object]] = []
    images: list[dict[str, object]] = []
    for number, piece in enumerate(pieces):
        primitives.append(_primitive(binary, piece, number, metres_per_unit))
        surface: dict[str, object] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        if piece.jpeg:
            surface["baseColorTexture"] = {"index": len(images)}
            images.append({"bufferView": binary.add(piece.jpeg), "mimeType": "image/jpeg"})
        materials.append(
            {"doubleSided": True, "pbrMetallicRoughness": surface, "extensions": {"KHR_materials_unlit": {}}}
        )
    moved = metres_per_unit * Y_UP_FROM_CAMERA * middle
    document: dict[str, object] = {
        "asset": {"version": "2.0", "generator": "roomscan"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": list(range(1 + len(cameras)))}],
        "nodes": [
            {"name": "scan", "mesh": 0} | ({"translation": moved.tolist()} if middle.any() else {}),
            *(_camera_node(camera, number, metres_per_unit) for number, camera in enumerate(cameras)),
        ],
        "meshes": [{"name": "scan", "primitives": primitives}],
        "cameras": [_camera(camera) for camera in cameras],
        "materials": materials,
        "accessors": binary.accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": binary.length}],
        "images": images,
        "samplers": [{"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAPS, "wrapS": _CLAMPED, "wrapT": _CLAMPED}],
        "textures": [{"source": number, "sampler": 0} for number in range(len(images))],
    }
    present = {key: value for key, value in document.items() if value != []}  # glTF knows no empty lists
    _write_container(path, json.dumps(present).encode(), binary)


def _camera_node(camera: GlbCamera, number: int, metres_per_unit: float) -> dict[str, object]:
    matrix = np.eye(4)
    matrix[:3, :3] = Y_UP_FROM_CAMERA[:, None] * camera.place.rotation * Y_UP_FROM_CAMERA
    matrix[:3, 3] = metres_per_unit * Y_UP_FROM_CAMERA * camera.place.translation
    columns = matrix.T.ravel().tolist()
    return {"name": camera.name, "camera": number, "matrix": columns, "extras": dict(camera.extras)}


def _camera(camera: GlbCamera) -> dict[str, object]:
    (fx, fy), (width, height) = camera.device.focal_px, camera.device.size
    lens = {
        "yfov": 2 * float(np.arctan(height / (2 * fy))),
        "aspectRatio": width * fy / (height * fx),
        "znear": camera.near,
        "zfar": camera.far,
    }
    return {"name": camera.name, "type": "perspective", "perspective": lens}


class _Binary:
    """The buffer, with its views and accessors."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.length = 0
        self.views: list[dict[str, object]] = []
        self.accessors: list[dict[str, object]] = []

    def add(self, data: bytes, **more: object) -> int:
        """Append data, padded to four bytes; the number of its view."""
        self.views.append({"buffer": 0, "byteOffset": self.length, "byteLength": len(data), **more})
        self.parts.append(data + b"\0" * (-len(data) % 4))
        self.length += len(self.parts[-1])
        return len(self.views) - 1

    def array(self, array: NDArray[np.generic], component: int, kind: str, target: int, **more: object) -> int:
        """Append an array; the number of its accessor."""
        view = self.add(array.tobytes(), target=target)
        self.accessors.append(
            {"bufferView": view, "componentType": component, "count": len(array), "type": kind, **more}
        )
        return len(self.accessors) - 1


def _primitive(binary: _Binary, piece: Piece, material: int, metres_per_unit: float) -> dict[str, object]:
    mesh = piece.mesh
    positions = (mesh.points * metres_per_unit * Y_UP_FROM_CAMERA).astype("<f4")
    normals = (mesh.normals * Y_UP_FROM_CAMERA).astype("<f4")
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    extent = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    attributes = {
        "POSITION": binary.array(positions, _FLOAT, "VEC3", _ARRAY_BUFFER, **extent),
        "NORMAL": binary.array(normals, _FLOAT, "VEC3", _ARRAY_BUFFER),
    }
    if piece.jpeg and piece.places is not None:
        attributes["TEXCOORD_0"] = binary.array(piece.places.astype("<f4"), _FLOAT, "VEC2", _ARRAY_BUFFER)
    else:
        colours = _linear_rgba(mesh.colours)
        attributes["COLOR_0"] = binary.array(colours, _UNSIGNED_SHORT, "VEC4", _ARRAY_BUFFER, normalized=True)
    corners = mesh.triangles.astype("<u4").reshape(-1, 1)
    indices = binary.array(corners, _UNSIGNED_INT, "SCALAR", _ELEMENT_ARRAY_BUFFER)
    return {"attributes": attributes, "indices": indices, "material": material, "mode": _TRIANGLES}


def _linear_rgba(colours: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """sRGB (N, 3) of 8 bit → linear (N, 4) of 16 bit, opaque (IEC 61966-2-1). 16, or dark shades would merge."""
    table = np.rint(65535 * linear_light()).astype("<u2")
    return np.hstack([table[colours], np.full((len(colours), 1), 65535, "<u2")])


def _write_container(path: Path, document: bytes, binary: _Binary) -> None:
    """Header and two chunks, each padded to a multiple of four bytes: JSON with spaces, binary with zeros."""
    document += b" " * (-len(document) % 4)
    with path.open("wb") as file:
        file.write(struct.pack("<III", _MAGIC, _VERSION, 12 + 8 + len(document) + 8 + binary.length))
        file.write(struct.pack("<II", len(document), _JSON_CHUNK))
        file.write(document)
        file.write(struct.pack("<II", binary.length, _BINARY_CHUNK))
        file.writelines(binary.parts)
