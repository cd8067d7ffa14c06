"""What light is mapped onto: the projectors of a result, and its surface as triangles, in one frame."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from calib.numerics import Floats
from scanner.errors import InputError
from scanner.exporting.triangles import Mesh, build_mesh, mesh_of, reconstruct_surface
from scanner.io import CloudPoints, StoredDevice, read_cloud, read_network
from scanner.results import (
    NETWORK_CLOUD_FILE,
    NETWORK_FILE,
    OBJECT_FILE,
    ROOM_FILE,
    capture_folders,
    read_finished_result,
)

_SHALLOWEST, _DEEPEST = 5, 9  # levels of the octree of the Poisson reconstruction; 9 is 512 cells per side
_AROUND = 1.1  # over the extent
_NEIGHBOURS = 6
_FAR = 4.0  # distance over the local point spacing, beyond which a surface is invented
_FEWEST = 50


@dataclass(frozen=True, eq=False)
class MappedScene:
    """`projectors` with their poses, and `mesh`, in the mesh's unit and the result's frame, y down.

    `baseline`: the devices whose distance is the unit, if no length is known.
    """

    projectors: tuple[StoredDevice, ...]
    mesh: Mesh
    baseline: str


def read_scene(result: Path, capture: int | None) -> MappedScene:
    """Of a network, or of a single camera and projector: those of a capture or station by number, by default of the
    newest capture. Raises InputError.
    """
    if (result / NETWORK_FILE).is_file():
        return _of_network(result)
    if capture is None and any((result / name).is_file() for name in (ROOM_FILE, OBJECT_FILE)):
        raise InputError(
            f"{result}: rig or object was moved between its stations, so no projector stands where it stood; "
            "export one station, as with --capture 1"
        )
    newest = len(capture_folders(result))
    (station,) = read_finished_result(result, newest if capture is None else capture).stations
    calibration = station.scan.calibration
    projector = StoredDevice("projector", "projector", calibration.projector, calibration.pose.inverse())
    return MappedScene((projector,), build_mesh(station.scan), "from camera to projector")


def _of_network(result: Path) -> MappedScene:
    network = read_network(result / NETWORK_FILE)
    projectors = tuple(each for each in network.devices if each.kind == "projector")
    if not projectors:
        raise InputError(f"{result / NETWORK_FILE}: has no projector, so there is nothing to map")
    mesh = surface_through(read_cloud(result / NETWORK_CLOUD_FILE), network.unit)
    if mesh is None:
        raise InputError(f"{result / NETWORK_CLOUD_FILE}: its points do not hang together as a surface to project on")
    first, second = (each.name for each in network.devices[:2])
    return MappedScene(projectors, mesh, f"from {first} to {second}")


def surface_through(cloud: CloudPoints, unit: str) -> Mesh | None:
    """Of all points with a normal, cut off where none is near; small holes are closed. None if nothing is left."""
    _, different = np.unique(cloud.points, axis=0, return_index=True)
    used = np.sort(different[np.linalg.norm(cloud.normals[different], axis=1) > 0.5])
    points: Floats = cloud.points[used]
    if len(points) < _FEWEST:
        return None
    tree = cKDTree(points)
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
    return mesh_of(mesh, unit) if len(mesh.triangles) else None
