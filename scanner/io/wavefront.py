"""Meshes as Wavefront OBJ. Faces may have any number of corners, as Blender's quadrangles do: Open3D leaves out what
is no triangle.
"""

import re
from pathlib import Path

import numpy as np

from calib.geometry import cross
from calib.numerics import Bools, Floats, Ints
from scanner.errors import InputError
from scanner.io.given_file import read_whole

_OTHER_INDICES = re.compile(rb"/[^\s]*")  # of texture and normals


def read_obj(path: Path) -> tuple[Floats, Ints]:
    """Vertices (V, 3) and triangles (T, 3), which may be none. Raises InputError if the file is missing or damaged."""
    text = read_whole(path).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    lines = [line for line in text.splitlines() if line[:1] in (b"v", b"f") and line[1:2] in (b" ", b"\t")]
    is_face: Bools = np.array([line.startswith(b"f") for line in lines], np.bool_)
    places = [line[2:] for line in lines if line.startswith(b"v")]
    faces = [_OTHER_INDICES.sub(b"", line[2:]) for line in lines if line.startswith(b"f")]
    try:
        vertices = np.loadtxt(places, usecols=(0, 1, 2), ndmin=2) if places else np.zeros((0, 3))
        before: Ints = np.cumsum(~is_face, dtype=np.int64)[is_face]  # vertices, from which negative numbers count back
        return vertices, _triangles(vertices, faces, before)
    except ValueError as error:
        raise InputError(f"{path}: is damaged: expected numbers in the lines of OBJ: {error}") from error


def _triangles(vertices: Floats, faces: list[bytes], before: Ints) -> Ints:
    """Triangles (T, 3) of faces, of which each has a number of vertices (F,) `before` it. Raises ValueError."""
    corners = np.array([len(face.split()) for face in faces], np.int64)
    triangles = [np.zeros((0, 3), np.int64)]
    for count in np.unique(corners[corners >= 3]):
        of_count = np.flatnonzero(corners == count)
        numbers = np.loadtxt([faces[k] for k in of_count], np.int64, ndmin=2)
        polygons = np.where(numbers < 0, numbers + before[of_count, None], numbers - 1)
        if polygons.min() < 0 or polygons.max() >= len(vertices):
            raise ValueError("a face has corners that do not exist")
        triangles.append(triangulated(vertices, polygons))
    return np.concatenate(triangles)


def triangulated(vertices: Floats, polygons: Ints) -> Ints:
    """Triangles (T, 3) that fill polygons (P, K) of vertices (V, 3), which may have reentrant corners."""
    count = polygons.shape[1]
    fans = np.stack([polygons[:, [0, k, k + 1]] for k in range(1, count - 1)], axis=1)
    if count == 3:
        return fans.reshape(-1, 3)
    normals = _cross(vertices, fans)
    whole = normals.sum(axis=1, keepdims=True)
    is_bent: Bools = np.any(np.sum(normals * whole, axis=2) < 0, axis=1)
    clipped = [_clipped(vertices, polygon) for polygon in polygons[is_bent]]
    return np.concatenate([fans[~is_bent].reshape(-1, 3), *clipped])


def _cross(vertices: Floats, triangles: Ints) -> Floats:
    a, b, c = (vertices[triangles[..., k]] for k in range(3))
    return cross(b - a, c - a)


def _clipped(vertices: Floats, polygon: Ints) -> Ints:
    """Triangles (K - 2, 3) of one polygon (K,): ears are cut off, one after the other."""
    rest, ears = list(polygon), list[list[int]]()
    around = vertices[polygon] - vertices[polygon].mean(axis=0)
    facing = cross(around, np.roll(around, -1, axis=0)).sum(axis=0)  # Newell
    while len(rest) > 3:
        at = next((k for k in range(len(rest)) if _is_ear(vertices, rest, k, facing)), 0)
        ears.append([rest[at - 1], rest[at], rest[(at + 1) % len(rest)]])
        del rest[at]
    return np.array([*ears, rest], np.int64)


def _is_ear(vertices: Floats, rest: list[int], at: int, facing: Floats) -> bool:
    """Whether a corner of what is left points outwards, and its triangle has no other corner in it."""
    ear = [rest[at - 1], rest[at], rest[(at + 1) % len(rest)]]
    a, b, c = vertices[ear]
    if cross(b - a, c - a) @ facing <= 0:
        return False
    outside = vertices[[corner for corner in rest if corner not in ear]]
    sides = [cross(end - begin, outside - begin) @ facing for begin, end in ((a, b), (b, c), (c, a))]
    return not bool(np.any(np.min(sides, axis=0) > 0)) if len(outside) else True
