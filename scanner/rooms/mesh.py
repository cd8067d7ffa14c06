"""The room as one surface: all stations' depths fused on a grid of signed distances, in which they are averaged.

Curless and Levoy, "A volumetric method for building complex models from range images", 1996; by Open3D.

All stations' points in one cloud: thinned by voxels, in each of which the points of several stations are blended.

Before, the deviations of a station's points from their plane are filtered in the image: each is moved to the mean of
its neighbours as far as their variance is that of noise (Lee, "Digital image enhancement and noise filtering by use of
local statistics", IEEE PAMI 2, 1980). So bent walls stay bent, and relief above the
noise stays. The filter works on inverse depth, where the noise of triangulation does not depend on the distance.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Intrinsics
from calib.numerics import Bools, Floats, Ints
from calib.pointcloud import NONE, MergedCloud, density, without_gaps
from scanner.exporting import Mesh, open3d
from scanner.rooms.contents import SolvedRoom, Station

_WINDOW = 7  # pixels
_FEWEST = 12  # points of the plane in a window
_SLACK = 1.5  # factor on the noise variance, which a small window estimates roughly
_VOXELS = 1.5  # in edges of the cloud's voxels
_TRUNCATED = 4.0  # truncation of signed distances, in edges of this grid's voxels
_BLOCK, _MOST_BLOCKS = 16, 8000  # voxels per edge of a block; each block takes 80 kB
_LEAST_PIECE = 200  # triangles of a piece
_LEAST_WEIGHT = 0.5  # weight of a voxel; one station is enough
_NO_NORMAL = np.array([0.0, -1.0, 0.0])  # for degenerate triangles
# From the room's axes (z up) to those of a level camera, in which meshes are written.
CAMERA_FROM_ROOM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def denoised(room: SolvedRoom, station: Station) -> NDArray[np.float32]:
    """The station's points (H, W, 3) in the camera's frame; those on no plane are unchanged."""
    points, there = station.cloud.points.copy(), station.cloud.there
    for number in np.unique(station.plane[there & (station.plane >= 0)]):
        on = there & (station.plane == number)
        around = cv2.boundingRect(on.view(np.uint8))
        part = slice(around[1], around[1] + around[3]), slice(around[0], around[0] + around[2])
        plane, place = room.planes[int(number)], station.place
        offset = plane.offset_from(place.translation)
        points[part][on[part]] = _smoothed(points[part], on[part], place.rotation.T @ plane.normal / offset)
    return points


def _smoothed(points: NDArray[np.float32], on: Bools, plane: Floats) -> Floats:
    """The points that are `on` a plane X · `plane` = 1, (N, 3), of a part of an image, (h, w, 3)."""
    depth = np.where(on, points[..., 2], 1.0).astype(np.float64)
    rays = np.where(on[..., None], points, 0.0) / depth[..., None]
    of_plane = rays @ plane
    deviation = np.where(on, 1 / depth - of_plane, 0.0)
    count = _summed(on.astype(np.float64))
    several = np.maximum(count, 2.0)
    mean = _summed(deviation) / several
    variance = np.maximum(_summed(deviation**2) / several - mean**2, 0.0) * several / (several - 1)
    supported = on & (count >= _FEWEST)
    if supported.any():
        noise = _SLACK * float(np.median(variance[supported]))
        kept = np.where(supported, np.clip(1 - noise / np.maximum(variance, noise), 0.0, 1.0), 1.0)
        deviation = mean + kept * (deviation - mean)
    inverse = np.where(supported, of_plane + deviation, 1 / depth)
    return (rays / inverse[..., None])[on]


def _summed(values: Floats) -> Floats:
    """Over the window around each pixel."""
    window = (_WINDOW, _WINDOW)
    return cv2.boxFilter(values, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT).astype(np.float64)


_VOXEL_PX = 2.0  # camera pixels at the median distance
_LEAST_DENSITY = 0.01  # points per pixel


def grid_of(stations: Sequence[Station], calibration: Calibration) -> float:
    """Edge of a voxel: the span of a few camera pixels at the median distance, larger for sparse points."""
    depths = np.concatenate([station.cloud.points[..., 2][station.cloud.there][::100] for station in stations])
    spacing = max(spacing_px(station.cloud.there) for station in stations)
    return spacing * _VOXEL_PX * float(np.median(depths)) / float(np.mean(calibration.camera.focal_px))


def spacing_px(there: Bools) -> float:
    """How far neighbouring points of an image (H, W) are apart; 1 where every pixel has one."""
    return 1 / float(np.sqrt(max(density(index_of(there)), _LEAST_DENSITY)))


def index_of(there: Bools) -> Ints:
    """The index of each pixel (H, W) with a point, NONE for others."""
    return np.where(there, np.arange(there.size).reshape(there.shape), NONE)


def blended(room: SolvedRoom) -> MergedCloud:
    """The room's, as `blended_of` makes it."""
    return blended_of(room.stations, room.calibration, [denoised(room, station) for station in room.stations])


def blended_of(
    stations: Sequence[Station], calibration: Calibration, clouds: Sequence[NDArray[np.float32]]
) -> MergedCloud:
    """Of the stations' points (H, W, 3), each in its camera's frame.

    In the room's frame; at most one point in each voxel: the mean of those in it, of its normals and colours.
    """
    o3d = open3d()
    together = o3d.geometry.PointCloud()
    grid = grid_of(stations, calibration)
    for station, cloud in zip(stations, clouds, strict=True):
        own = o3d.geometry.PointCloud()
        there = station.cloud.there
        points = station.to_room(cloud[there].astype(np.float64))
        own.points = o3d.utility.Vector3dVector(points)
        normals = station.place.rotate(station.cloud.normals[there].astype(np.float64))
        own.normals = o3d.utility.Vector3dVector(normals)
        own.colors = o3d.utility.Vector3dVector(station.cloud.colours[there] / 255.0)
        # Each station first by itself, to limit memory; then all together.
        together += own.voxel_down_sample(grid / 2)
    thinned = together.voxel_down_sample(grid)
    normals = np.asarray(thinned.normals)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colours = np.rint(255 * np.asarray(thinned.colors)).astype(np.uint8)
    return MergedCloud(
        np.asarray(thinned.points).astype(np.float32),
        colours,
        normals.astype(np.float32),
        calibration.unit,
        grid,
        (),
        tuple(station.place for station in stations),
    )


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
    nearest_depth = cv2.remap(depth, column, row, nearest, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    colour = cv2.remap(station.cloud.colours, column, row, nearest, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return ideal, np.ascontiguousarray(nearest_depth, np.float32), (colour / 255.0).astype(np.float32)


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
    points, normals = (np.asarray(vectors) @ CAMERA_FROM_ROOM.T for vectors in (mesh.vertices, mesh.vertex_normals))
    normals = np.where(np.linalg.norm(normals, axis=1, keepdims=True) > 0, normals, _NO_NORMAL)
    colours = np.rint(255 * np.asarray(mesh.vertex_colors)).astype(np.uint8)
    return Mesh(points, normals, colours, np.asarray(mesh.triangles).astype(np.int64), unit)
