"""What light is mapped onto: the projectors of a result, its surface as triangles, and the largest wall of a room, all
in one frame.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from calib.numerics import Bools, Floats
from calib.pointcloud import fit_plane
from scanner.cleaning import read_cleaned
from scanner.errors import InputError
from scanner.exporting.result_mesh import surface_through, with_mesh_steps
from scanner.exporting.triangles import Mesh, build_mesh
from scanner.io import StoredDevice, read_network
from scanner.results import (
    NETWORK,
    capture_folders,
    kind_of,
    read_steps,
)

_TRIES, _SAMPLE = 300, 20_000
_NEAR = 0.005  # distance from a plane, over the surface's extent
_ALIKE = np.cos(np.radians(20.0))  # cosine between the normals of a plane's points
_UPRIGHT = np.cos(np.radians(45.0))  # a wall's normal is farther from the vertical than this
_LEVEL = np.cos(np.radians(5.0))
_UP = np.array([0.0, -1.0, 0.0])


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
    kind = kind_of(result)
    if kind is NETWORK:
        return _of_network(result)
    if capture is None and kind.is_joined:
        raise InputError(
            f"{result}: rig or object was moved between its stations, so no projector stands where it stood; "
            "export one station, as with --capture 1"
        )
    newest = len(capture_folders(result))
    number = newest if capture is None else capture
    (station,) = read_cleaned(result, number, own_axes=True).stations
    calibration = station.scan.calibration
    projector = StoredDevice("projector", "projector", calibration.projector, calibration.pose.inverse())
    mesh = with_mesh_steps(build_mesh(station.scan), read_steps(result))
    return MappedScene((projector,), mesh, "from camera to projector")


def _of_network(result: Path) -> MappedScene:
    network = read_network(result / NETWORK.listing)
    projectors = tuple(network_device for network_device in network.devices if network_device.kind == "projector")
    if not projectors:
        raise InputError(f"{result / NETWORK.listing}: has no projector, so there is nothing to map")
    cleaned = read_cleaned(result, own_axes=True)
    mesh = surface_through(cleaned.cloud())
    if mesh is None:
        raise InputError(f"{result / NETWORK.cloud}: its points do not hang together as a surface to project on")
    mesh = with_mesh_steps(mesh, cleaned.steps)
    first, second = (device.name for device in network.devices[:2])
    return MappedScene(projectors, mesh, f"from {first} to {second}")


@dataclass(frozen=True, eq=False)
class MappedWall:
    """The points X with `normal` · X = `offset`; the normal (3,) points to the viewer. `within`: distance tolerance of
    its points.
    """

    normal: Floats
    offset: float
    within: float

    @cached_property
    def axes(self) -> Floats:
        """The directions right and up on the wall, (3, 2), unit vectors."""
        vertical = _UP if abs(self.normal @ _UP) < _LEVEL else np.array([0.0, 0.0, 1.0])
        up = vertical - (vertical @ self.normal) * self.normal
        up /= np.linalg.norm(up)
        return np.stack([np.cross(up, self.normal), up], axis=1)


@dataclass(frozen=True, eq=False)
class WallView:
    """The `wall` that shows the picture, and the `eye` (3,) that sees it undistorted; without one, from straight ahead
    and far away.
    """

    wall: MappedWall
    eye: Floats | None

    def refuse_behind(self) -> None:
        """Raise InputError if the eye is behind the wall."""
        if self.eye is not None and self.eye @ self.wall.normal <= self.wall.offset:
            raise InputError(
                "--eye: is behind the largest wall; expected a place in the room, in the axes of mapping.glb: x right, "
                "y up, z backward, in metres"
            )


def largest_wall(mesh: Mesh) -> MappedWall:
    """The plane with the most surface among those that are upright, or of all if none is. The first device is upright.

    RANSAC over points with normals, weighted by the area around them, then least squares.
    """
    corners = mesh.points[mesh.triangles]
    double = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    area = np.bincount(mesh.triangles.ravel(), np.repeat(double, 3), len(mesh.points))
    rng = np.random.default_rng(0)
    sample = rng.choice(len(area), _SAMPLE, p=area / area.sum())
    points, normals = mesh.points[sample], mesh.normals[sample]
    upright = np.flatnonzero(np.abs(normals @ _UP) < _UPRIGHT)
    tried = rng.choice(upright if len(upright) else _SAMPLE, _TRIES)
    within = _NEAR * float(np.linalg.norm(np.ptp(mesh.points, axis=0)))

    def on_plane(number: int) -> Bools:
        near = np.abs((points - points[number]) @ normals[number]) < within
        alike: Bools = near & (normals @ normals[number] > _ALIKE)
        return alike

    best = max(tried, key=lambda number: np.count_nonzero(on_plane(number)))
    on = points[on_plane(best)]
    try:
        plane = fit_plane(on, np.arange(len(on)))
    except ValueError as error:
        raise InputError(f"no wall is found to show a picture on: {error}") from error
    sign = np.sign(plane.normal @ normals[best])
    return MappedWall(sign * plane.normal, float(sign * plane.offset), within)
