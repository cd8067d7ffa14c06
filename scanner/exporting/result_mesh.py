"""The mesh of a result as its steps leave it, and the steps that change a mesh: holes that are closed, fewer triangles.

Holes are closed, and triangles reduced by quadric error metrics (Garland and Heckbert, 1997), by Open3D.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from calib.geometry import IDENTITY, Pose
from calib.numerics import Bools, Floats, Ints
from scanner.cleaning import CleanedCloud, CleanedResult, axes_of, inside_box, length_of
from scanner.configuration import CloudStep
from scanner.errors import InputError
from scanner.exporting.triangles import (
    Y_UP_FROM_CAMERA,
    Mesh,
    build_joint_mesh,
    mesh_of,
    open3d,
    reconstruct_surface,
)
from scanner.exporting.units import in_metres
from scanner.io import read_whole

_SHALLOWEST, _DEEPEST = 5, 9  # levels of the octree of the Poisson reconstruction; 9 is 512 cells per side
_AROUND = 1.1  # over the extent
_NEIGHBOURS = 6
_FAR = 4.0  # distance over the local point spacing, beyond which a surface is invented
_FEWEST = 50
_HEADER, _CHUNK = 12, 8  # bytes of a GLB
# From axes with z up to those of a level camera, in which meshes are.
_LEVEL = Pose(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.zeros(3))


def mesh_of_result(result: CleanedResult, *, coloured: bool = False) -> Mesh:
    """The triangles of all scans, of a room or an object, or through a network's cloud, in a camera's axes, y down.

    `coloured`: a room's and an object's, too, whose colours are in pictures. Raises InputError.
    """
    if result.whole.mesh is not None:
        mesh = _joined(result, result.whole.mesh, coloured=coloured)
    elif not result.stations:
        through = surface_through(result.cloud())
        if through is None:
            raise InputError(f"{result.whole.cloud}: its points do not hang together as a surface")
        mesh = through if result.axes is None else _moved(through, _LEVEL)
    else:
        stations = result.stations_before_camera
        if result.axes is not None:
            stations = tuple(replace(station, place=_LEVEL @ station.place) for station in stations)
        mesh = build_joint_mesh(stations)
    return with_mesh_steps(mesh, result.steps)


def mesh_in_axes(result: CleanedResult) -> Mesh:
    """The same mesh in the axes of the result's cloud, or of its steps. Raises InputError."""
    mesh = mesh_of_result(result)
    if result.is_upright:
        return _moved(mesh, _LEVEL.inverse())
    return mesh if len(result.whole.stations) < 2 else _moved(mesh, result.whole.stations[-1].place)


def with_mesh_steps(mesh: Mesh, steps: Sequence[CloudStep]) -> Mesh:
    """The mesh after those of the steps that change one. Raises InputError."""
    for step in steps:
        try:
            if step.fill is not None:
                mesh = fill_holes(mesh, length_of(step, mesh.unit))
            elif step.triangles is not None:
                mesh = reduce_triangles(mesh, step.triangles)
        except InputError as error:
            raise InputError(f"step '{step}': {error}") from error
    return mesh


def fill_holes(mesh: Mesh, size: float) -> Mesh:
    """With triangles across the holes that fit into a sphere of this diameter. Raises InputError if the outer edge
    would count as one.
    """
    extent = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
    if size >= extent:
        raise InputError(
            f"expected a size below that of the surface, which is {extent:.4g} {mesh.unit} across: its outer edge "
            "would be closed as well"
        )
    o3d = open3d()
    tensors = o3d.core.Tensor(mesh.points.astype(np.float64)), o3d.core.Tensor(mesh.triangles.astype(np.int64))
    filled = o3d.t.geometry.TriangleMesh(*tensors).fill_holes(size / 2)
    triangles = filled.triangle.indices.numpy().astype(np.int64)
    return replace(mesh, triangles=_facing(mesh, triangles))


def _facing(mesh: Mesh, triangles: Ints) -> Ints:
    """Those that are new turned to the side of the points' normals."""
    new = triangles[len(mesh.triangles) :]
    a, b, c = (mesh.points[new[:, k]] for k in range(3))
    away = np.sum(np.cross(b - a, c - a) * mesh.normals[new].sum(axis=1), axis=1) < 0
    new[away] = new[away][:, ::-1]
    return np.concatenate([triangles[: len(mesh.triangles)], new])


def reduce_triangles(mesh: Mesh, count: int) -> Mesh:
    """With at most so many triangles. Raises InputError if there are not more."""
    if count >= len(mesh.triangles):
        raise InputError(f"expected fewer than the mesh has, which is {len(mesh.triangles):,}, found {count:,}")
    o3d = open3d()
    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.points), o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32))
    )
    whole.vertex_colors = o3d.utility.Vector3dVector(mesh.colours / 255.0)
    reduced = mesh_of(whole.simplify_quadric_decimation(count), mesh.unit)
    if not len(reduced.triangles):
        raise InputError(f"{count:,} triangles are too few for this surface: nothing is left")
    return reduced


def _joined(result: CleanedResult, path: Path, *, coloured: bool) -> Mesh:
    """The mesh of a room or an object, without what the steps take away, and without its pictures."""
    metres, _ = in_metres(result.unit)
    read, triangles = read_triangles(path)
    points: Floats = _LEVEL.inverse() @ (read * Y_UP_FROM_CAMERA / metres)
    normals = np.zeros_like(points)
    colours = np.full(points.shape, 128, np.uint8)
    if result.steps or coloured:
        whole = replace(result, steps=(), axes=None).cloud()
        nearest = np.asarray(scipy.spatial.cKDTree(whole.points).query(points)[1])
        colours = whole.colours[nearest]
    mesh = Mesh(points, normals, colours, triangles, result.unit)
    if result.steps:
        last = result.clouds()[-1]
        stays = np.zeros(len(whole.points), np.bool_)
        stays[last.number] = True
        mesh = _part(mesh, stays[nearest] & _in_boxes(result, points))
        mesh = mesh if result.axes is None else _moved(mesh, last.frame)
    return _with_normals(_moved(mesh, _LEVEL))


def _in_boxes(result: CleanedResult, points: Floats) -> Bools:
    """Which points (N, 3) in the result's axes are in all boxes of the steps, (N,)."""
    inside, frame = np.ones(len(points), np.bool_), IDENTITY
    for step in result.steps:
        if step.box is not None:
            inside &= inside_box(frame @ points, step.box, result.unit)
        elif step.axes is not None:
            frame = axes_of(step.axes, result.unit) @ frame
        elif step.floor:
            frame = result.floor()
    return inside


def _part(mesh: Mesh, stays: Bools) -> Mesh:
    """The triangles between points (N,) that stay. Raises InputError if there are none."""
    kept = mesh.triangles[np.all(stays[mesh.triangles], axis=1)]
    if not len(kept):
        raise InputError("the steps leave no triangle of the mesh: take a larger box, or export the cloud as ply")
    used, corners = np.unique(kept, return_inverse=True)
    return Mesh(
        mesh.points[used],
        mesh.normals[used],
        mesh.colours[used],
        corners.reshape(kept.shape).astype(np.int64),
        mesh.unit,
    )


def _moved(mesh: Mesh, pose: Pose) -> Mesh:
    return replace(mesh, points=pose @ mesh.points, normals=pose.rotate(mesh.normals))


def _with_normals(mesh: Mesh) -> Mesh:
    """With normals of the points, from those of their triangles by area."""
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    facing = np.cross(b - a, c - a)
    normals = np.zeros_like(mesh.points)
    for k in range(3):
        np.add.at(normals, mesh.triangles[:, k], facing)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(mesh, normals=np.where(length > 0, normals / np.maximum(length, 1e-300), [0.0, -1.0, 0.0]))


def surface_through(cloud: CleanedCloud) -> Mesh | None:
    """Of all points with a normal, cut off where none is near; small holes are closed. None if nothing is left."""
    _, different = np.unique(cloud.points, axis=0, return_index=True)
    used = np.sort(different[np.linalg.norm(cloud.normals[different], axis=1) > 0.5])
    points: Floats = cloud.points[used]
    if len(points) < _FEWEST:
        return None
    tree = scipy.spatial.cKDTree(points)
    spacing = np.asarray(tree.query(points, _NEIGHBOURS)[0])[:, -1]
    cells = float(np.max(np.ptp(points, axis=0))) / float(np.median(spacing))
    depth = int(np.clip(np.ceil(np.log2(cells)), _SHALLOWEST, _DEEPEST))
    mesh = reconstruct_surface(points, cloud.normals[used], cloud.colours[used], depth=depth, scale=_AROUND)
    vertices = np.asarray(mesh.vertices)
    if not np.isfinite(vertices).all():  # the points are too far apart for a surface
        return None
    apart, nearest = tree.query(vertices)
    mesh.remove_vertices_by_mask(apart > _FAR * spacing[nearest])
    mesh.remove_degenerate_triangles()
    return mesh_of(mesh, cloud.unit) if len(mesh.triangles) else None


def read_triangles(path: Path) -> tuple[Floats, Ints]:
    """Points (N, 3) and triangles (T, 3) of a GLB as this program writes them. Raises InputError for any other."""
    data = read_whole(path)
    try:
        length = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
        document = json.loads(data[_HEADER + _CHUNK : _HEADER + _CHUNK + length])
        binary = data[_HEADER + 2 * _CHUNK + length :]
        parts, corners, count = [], [], 0
        for piece in document["meshes"][0]["primitives"]:
            points, indices = (
                _array(document, binary, piece["attributes"]["POSITION"], "<f4"),
                _array(document, binary, piece["indices"], "<u4"),
            )
            parts.append(points.reshape(-1, 3))
            corners.append(indices.astype(np.int64).reshape(-1, 3) + count)
            count += len(parts[-1])
        points, same = np.unique(np.concatenate(parts), axis=0, return_inverse=True)
        triangles = same.reshape(-1)[np.concatenate(corners)].astype(np.int64)
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(f"{path}: expected a mesh as this program writes it, found a damaged file") from error
    return points.astype(np.float64), triangles


def _array(document: dict, binary: bytes, number: int, kind: str) -> np.ndarray:  # type: ignore[type-arg]
    view = document["bufferViews"][document["accessors"][number]["bufferView"]]
    return np.frombuffer(binary, kind, view["byteLength"] // 4, view["byteOffset"])
