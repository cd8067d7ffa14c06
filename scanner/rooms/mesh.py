"""The room as one surface: all stations' depths fused on a grid of signed distances, in which they are averaged.

Curless and Levoy, "A volumetric method for building complex models from range images", 1996; by Open3D.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics
from calib.numerics import Floats
from scanner.exporting.triangles import Mesh
from scanner.rooms.blended_cloud import grid_of
from scanner.rooms.contents import SolvedRoom, Station
from scanner.rooms.open3d_module import open3d

_VOXELS, _TRUNCATED = 1.5, 4.0  # edges of the cloud's voxels; edges of this grid's
_LEAST_PIECE = 200  # triangles
# The room's axes (z up) as those of a camera that is held level, from which meshes are written.
_CAMERA_FROM_ROOM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def fused(room: SolvedRoom) -> Mesh:
    """The mesh, in the frame of a level camera at the room's origin: x along the room's x, y down, z along its y."""
    o3d = open3d()
    voxel = _VOXELS * grid_of(room.stations, room.calibration)
    volume = o3d.pipelines.integration.ScalableTSDFVolume(
        voxel_length=voxel,
        sdf_trunc=_TRUNCATED * voxel,
        color_type=o3d.pipelines.integration.TSDFVolumeColorType.RGB8,
    )
    for station in room.stations:
        camera, depth, colour = _ideal(station, room.calibration.camera)
        image = o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(colour),
            o3d.geometry.Image(depth),
            depth_scale=1.0,
            depth_trunc=float(depth.max()) + voxel,
            convert_rgb_to_intensity=False,
        )
        pinhole = o3d.camera.PinholeCameraIntrinsic(
            camera.width, camera.height, *camera.focal_px, *camera.principal_point_px
        )
        volume.integrate(image, pinhole, _into_camera(station))
    return _cleaned(volume.extract_triangle_mesh(), room.unit)


def _ideal(
    station: Station, camera: Intrinsics
) -> tuple[Intrinsics, NDArray[np.float32], NDArray[np.uint8]]:
    """What a camera without distortion sees of a station's points: depth (H, W), 0 for none, and colours."""
    ideal = Intrinsics(camera.width, camera.height, camera.focal_px, camera.principal_point_px)
    x, y = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    pixels = camera.project(ideal.unproject(np.stack([x, y], axis=-1))).astype(np.float32)
    depth = np.nan_to_num(station.cloud.points[..., 2], nan=0.0).astype(np.float32)
    nearest = cv2.INTER_NEAREST  # between a surface and what is behind it there is nothing
    seen = cv2.remap(depth, pixels, None, nearest, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    colour = cv2.remap(station.cloud.colours, pixels, None, nearest, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return ideal, np.ascontiguousarray(seen, np.float32), np.ascontiguousarray(colour, np.uint8)


def _into_camera(station: Station) -> Floats:
    """X_camera from X_room, (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = station.place.rotation.T
    matrix[:3, 3] = -station.place.rotation.T @ station.place.translation
    return matrix


def _cleaned(mesh: Any, unit: str) -> Mesh:
    """Without crumbs, with normals."""
    cluster, count, _ = mesh.cluster_connected_triangles()
    mesh.remove_triangles_by_mask(np.asarray(count)[np.asarray(cluster)] < _LEAST_PIECE)
    mesh.remove_unreferenced_vertices()
    mesh.compute_vertex_normals()
    points, normals = (np.asarray(each) @ _CAMERA_FROM_ROOM.T for each in (mesh.vertices, mesh.vertex_normals))
    colours = np.rint(255 * np.asarray(mesh.vertex_colors)).astype(np.uint8)
    return Mesh(points, normals, colours, np.asarray(mesh.triangles).astype(np.int64), unit)
