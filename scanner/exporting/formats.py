"""Which formats there are, what each is called on disk, and how it is written."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scanner.errors import InputError
from scanner.exporting.colmap import DEFAULT_POINTS, write_colmap
from scanner.exporting.e57 import refuse_without_pye57, write_e57
from scanner.exporting.glb import write_glb
from scanner.exporting.mesh import Mesh, build_mesh, write_mesh_obj, write_mesh_ply
from scanner.exporting.opencv import write_opencv
from scanner.io import new_file
from scanner.quantities import UNKNOWN_UNIT, metres_per, unit_name
from scanner.results import CLOUD_FILE, FinishedScan, read_calibration_of, read_finished_scan


@dataclass(frozen=True)
class Request:
    """What to export where: `result` is a result folder; `most_points` is for formats that hold some points only."""

    result: Path
    out: Path
    overwrite: bool = False
    most_points: int = DEFAULT_POINTS


@dataclass(frozen=True)
class Format:
    """A target: `suffixes` its files may have (none: a folder), the default first, and `ending`, for a default name.

    `write` returns what to tell about the export, in sentences. It raises InputError and OSError.
    """

    about: str
    ending: str
    suffixes: tuple[str, ...]
    write: Callable[[Request], list[str]]

    def check_name(self, out: Path) -> None:
        """Raise InputError if a file of this format is not called like that."""
        if self.suffixes and out.suffix.lower() not in self.suffixes:
            raise InputError(f"{out}: expected a name that ends in {' or '.join(self.suffixes)}")


def _opencv(request: Request) -> list[str]:
    calibration = read_calibration_of(request.result)
    with new_file(request.out, overwrite=request.overwrite) as path:
        write_opencv(path, calibration)
    return [f"Both devices' matrices and distortion, R, and T in {unit_name(calibration.unit)}"]


def _colmap(request: Request) -> list[str]:
    scan = read_finished_scan(request.result)
    model = write_colmap(request.out, scan, most_points=request.most_points, overwrite=request.overwrite)
    chosen = "all of them" if model.step == 1 else f"one for each {model.step} × {model.step} camera pixels"
    return [f"{model.points:,} of {len(scan):,} points with their tracks ({chosen}), in {unit_name(scan.unit)}"]


def _ply(request: Request) -> list[str]:
    scan = read_finished_scan(request.result)
    cloud = (request.result / CLOUD_FILE).read_bytes()
    with new_file(request.out, overwrite=request.overwrite) as path:
        path.write_bytes(cloud)
    return [f"{len(scan):,} points in {unit_name(scan.unit)}"]


def _e57(request: Request) -> list[str]:
    refuse_without_pye57()
    scan = read_finished_scan(request.result)
    metres, remarks = _metres(scan)
    with new_file(request.out, overwrite=request.overwrite) as path:
        write_e57(path, scan, metres)
    return [f"{len(scan):,} points in metres", *remarks]


def _mesh(request: Request) -> list[str]:
    scan = read_finished_scan(request.result)
    mesh = build_mesh(scan)
    unit, remarks = unit_name(scan.unit), list[str]()
    with new_file(request.out, overwrite=request.overwrite) as path:
        if path.suffix.lower() == ".glb":
            metres, remarks = _metres(scan)
            unit = "metres"
            write_glb(path, mesh, metres)
        else:
            _MESH_WRITERS[path.suffix.lower()](path, mesh)
    return [f"{len(mesh.triangles):,} triangles between {len(mesh.points):,} points, in {unit}", *remarks]


_MESH_WRITERS: dict[str, Callable[[Path, Mesh], None]] = {".ply": write_mesh_ply, ".obj": write_mesh_obj}


def _metres(scan: FinishedScan) -> tuple[float, list[str]]:
    """Metres per unit of a scan, for formats that know no other unit, and what to tell about it."""
    if scan.unit == UNKNOWN_UNIT:
        return 1.0, ["Note: no length is known, so one baseline, from camera to projector, was written as one metre."]
    return metres_per(scan.unit), []


FORMATS: dict[str, Format] = {
    "opencv": Format("calibration as OpenCV's FileStorage", "-opencv.yaml", (".yaml", ".yml"), _opencv),
    "colmap": Format("text model with some of the points", "-colmap", (), _colmap),
    "ply": Format("the cloud", "-cloud.ply", (".ply",), _ply),
    "e57": Format("the cloud, upright and in metres (needs pye57)", ".e57", (".e57",), _e57),
    "mesh": Format("triangles, by the name's ending GLB, PLY or OBJ", "-mesh.glb", (".glb", ".ply", ".obj"), _mesh),
}
