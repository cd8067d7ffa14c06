"""A mesh as binary glTF 2.0: one node, one mesh, one buffer.

glTF is right-handed, y up, in metres, a camera looks along −z, and vertex colours are linear. The colours are the
camera's, lit by the projector, so the material is unlit and shows them as they are.
"""

import json
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanner.exporting.triangles import Y_UP_FROM_CAMERA, Mesh

# Numbers of the glTF 2.0 specification.
_MAGIC, _VERSION = 0x46546C67, 2
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED_SHORT, _UNSIGNED_INT = 5126, 5123, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_TRIANGLES = 4


def write_glb(path: Path, mesh: Mesh, metres_per_unit: float) -> None:
    """Write positions in metres, normals, colours and triangles. Raises OSError."""
    positions = (mesh.points * metres_per_unit * Y_UP_FROM_CAMERA).astype("<f4")
    normals = (mesh.normals * Y_UP_FROM_CAMERA).astype("<f4")
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    arrays = (positions, normals, _linear_rgba(mesh.colours), mesh.triangles.astype("<u4").reshape(-1, 1))
    offsets = np.cumsum([0, *(array.nbytes for array in arrays)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": target}
        for array, offset, target in zip(arrays, offsets, [_ARRAY_BUFFER] * 3 + [_ELEMENT_ARRAY_BUFFER], strict=False)
    ]
    accessors = [
        {
            **_accessor(0, arrays[0], _FLOAT, "VEC3"),
            "min": positions.min(axis=0).tolist(),
            "max": positions.max(axis=0).tolist(),
        },
        _accessor(1, arrays[1], _FLOAT, "VEC3"),
        {**_accessor(2, arrays[2], _UNSIGNED_SHORT, "VEC4"), "normalized": True},
        _accessor(3, arrays[3], _UNSIGNED_INT, "SCALAR"),
    ]
    primitive = {
        "attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2},
        "indices": 3,
        "material": 0,
        "mode": _TRIANGLES,
    }
    material = {
        "doubleSided": True,
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
        "extensions": {"KHR_materials_unlit": {}},
    }
    document = {
        "asset": {"version": "2.0", "generator": "roomscan"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "scan", "mesh": 0}],
        "meshes": [{"name": "scan", "primitives": [primitive]}],
        "materials": [material],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offsets[-1]}],
    }
    path.write_bytes(_container(json.dumps(document).encode(), b"".join(array.tobytes() for array in arrays)))


def _accessor(view: int, array: NDArray[np.generic], component: int, kind: str) -> dict[str, object]:
    return {"bufferView": view, "componentType": component, "count": len(array), "type": kind}


def _linear_rgba(colours: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """sRGB (N, 3) of 8 bit → linear (N, 4) of 16 bit, opaque (IEC 61966-2-1). 16, or dark shades would merge."""
    encoded = np.arange(256) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    table = np.rint(65535 * linear).astype("<u2")
    return np.hstack([table[colours], np.full((len(colours), 1), 65535, "<u2")])


def _container(document: bytes, binary: bytes) -> bytes:
    """Header and two chunks, each padded to a multiple of four bytes: JSON with spaces, binary with zeros."""
    document += b" " * (-len(document) % 4)
    binary += b"\0" * (-len(binary) % 4)
    total = 12 + 8 + len(document) + 8 + len(binary)
    return b"".join(
        [
            struct.pack("<III", _MAGIC, _VERSION, total),
            struct.pack("<II", len(document), _JSON_CHUNK),
            document,
            struct.pack("<II", len(binary), _BINARY_CHUNK),
            binary,
        ]
    )
