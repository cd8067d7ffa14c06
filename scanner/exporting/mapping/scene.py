"""What light is mapped onto: the projectors of a result, and its surface as triangles, in one frame."""

from dataclasses import dataclass
from pathlib import Path

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
    projectors = tuple(each for each in network.devices if each.kind == "projector")
    if not projectors:
        raise InputError(f"{result / NETWORK.listing}: has no projector, so there is nothing to map")
    cleaned = read_cleaned(result, own_axes=True)
    mesh = surface_through(cleaned.cloud())
    if mesh is None:
        raise InputError(f"{result / NETWORK.cloud}: its points do not hang together as a surface to project on")
    mesh = with_mesh_steps(mesh, cleaned.steps)
    first, second = (device.name for device in network.devices[:2])
    return MappedScene(projectors, mesh, f"from {first} to {second}")
