"""The room as one surface: all stations' depths fused on a grid of signed distances, in which they are averaged.

Curless and Levoy, "A volumetric method for building complex models from range images", 1996; by Open3D.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics
from calib.pointcloud import NONE, without_gaps
from scanner.exporting import Mesh, open3d
from scanner.rooms.blended_cloud import denoised, grid_of, index_of
from scanner.rooms.contents import SolvedRoom, Station

_VOXELS = 1.5  # in edges of the cloud's voxels
_TRUNCATED = 4.0  # truncation of signed distances, in edges of this grid's voxels
_BLOCK, _MOST_BLOCKS = 16, 8000  # voxels per edge of a block; each block takes 80 kB
_LEAST_PIECE = 200  # triangles of a piece
_LEAST_WEIGHT = 0.5  # weight of a voxel; one station is enough
_NO_NORMAL = np.array([0.0, -1.0, 0.0])  # for degenerate triangles
# From the room's axes (z up) to those of a level camera, in which meshes are written.
CAMERA_FROM_ROOM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def fused(room: SolvedRoom) -> Mesh | None:
    """The mesh of the stations' denoised depths; None if there is no connected surface.

    It is in the frame of a level camera at the room's origin: x along the room's x, y down, z along its y.
    """
    o3d = open3d()
    views = [_view(o3d, station, denoised(room, station)[..., 2], room.calibration.camera) for station in room.stations]
    voxel = _VOXELS * grid_of(room.stations, room.calibration)
    while True:
        volume = o3d.t.geometry.VoxelBlockGrid(
            attr_names=("tsdf", "weight", "color"),
            attr_dtypes=(o3d.core.float32,) * 3,
            attr_channels=(1, 1, 3),
            voxel_size=voxel,
            block_resolution=_BLOCK,
            block_count=_MOST_BLOCKS,
        )
        blocks = [volume.compute_unique_block_coordinates(*view.of_depth, *view.reach, _TRUNCATED) for view in views]
        count = sum(len(block) for block in blocks)
        if count <= _MOST_BLOCKS:
            break
        voxel *= 1.1 * float(np.sqrt(count / _MOST_BLOCKS))
    for view, near in zip(views, blocks, strict=True):
        depth, intrinsic, extrinsic = view.of_depth
        volume.integrate(near, depth, view.colour, intrinsic, intrinsic, extrinsic, *view.reach, _TRUNCATED)
    return _cleaned(volume.extract_triangle_mesh(_LEAST_WEIGHT).to_legacy(), room.calibration.unit)


class _View(NamedTuple):
    """What Open3D takes of a station: depth image, intrinsic and extrinsic matrix; colours; depth's unit and limit."""

    of_depth: tuple[Any, Any, Any]
    colour: Any
    reach: tuple[float, float]


def _view(o3d: Any, station: Station, depths: NDArray[np.float32], camera: Intrinsics) -> _View:
    ideal, depth, colour = _ideal(station, depths, camera)
    (fx, fy), (x0, y0) = ideal.focal_px, ideal.principal_point_px
    # Open3D takes the pixel by truncation; half a pixel makes it the nearest.
    intrinsic = np.array([[fx, 0.0, x0 + 0.5], [0.0, fy, y0 + 0.5], [0.0, 0.0, 1.0]])
    images = (o3d.t.geometry.Image(o3d.core.Tensor(image)) for image in (depth[..., None], colour))
    depth_image, colour_image = images
    matrices = (o3d.core.Tensor(intrinsic), o3d.core.Tensor(station.place.inverse().matrix))
    return _View((depth_image, *matrices), colour_image, (1.0, 1.01 * float(depth.max())))


def _ideal(
    station: Station, depths: NDArray[np.float32], camera: Intrinsics
) -> tuple[Intrinsics, NDArray[np.float32], NDArray[np.float32]]:
    """What a camera without distortion sees of points with `depths` (H, W): depth, 0 for none; colours up to 1."""
    ideal = Intrinsics(camera.width, camera.height, camera.focal_px, camera.principal_point_px)
    pixels = camera.project(ideal.unproject(camera.size.pixels)).astype(np.float32)
    depth = filled(depths)
    nearest = cv2.INTER_NEAREST  # no interpolation between a surface and the one behind it
    column, row = np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])
    seen = cv2.remap(depth, column, row, nearest, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    colour = cv2.remap(station.cloud.colours, column, row, nearest, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return ideal, np.ascontiguousarray(seen, np.float32), (colour / 255.0).astype(np.float32)


def filled(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Depths (H, W), 0 for none; pixels between sparse points have the nearest one's."""
    index = without_gaps(index_of(np.isfinite(depth)))
    return np.where(index == NONE, np.float32(0.0), depth.ravel()[index]).astype(np.float32)


def _cleaned(mesh: Any, unit: str) -> Mesh | None:
    """Without crumbs, with normals."""
    cluster, count, _ = mesh.cluster_connected_triangles()
    mesh.remove_triangles_by_mask(np.asarray(count)[np.asarray(cluster)] < _LEAST_PIECE)
    mesh.remove_degenerate_triangles()
    if len(mesh.triangles) == 0:
        return None
    mesh.remove_unreferenced_vertices()
    mesh.compute_vertex_normals()
    points, normals = (np.asarray(each) @ CAMERA_FROM_ROOM.T for each in (mesh.vertices, mesh.vertex_normals))
    normals = np.where(np.linalg.norm(normals, axis=1, keepdims=True) > 0, normals, _NO_NORMAL)
    colours = np.rint(255 * np.asarray(mesh.vertex_colors)).astype(np.uint8)
    return Mesh(points, normals, colours, np.asarray(mesh.triangles).astype(np.int64), unit)
