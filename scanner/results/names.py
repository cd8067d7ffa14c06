"""The names in a result folder, and which names for one are free."""

from pathlib import Path

from scanner.errors import InputError
from scanner.io import MATCHES_FILE, given_path
from scanner.results.unfinished import is_held

CALIBRATION_FILE = "calibration.yaml"
TRUTH_FILE = "truth.yaml"
CLOUD_FILE = "cloud.ply"
REPORT_FILE = "report.html"
# Of boards: the calibration with lens terms that they left out, for captures of a corner that contradict it.
REFUSAL_FILE = "refused.yaml"
CAPTURE_FOLDER = "capture"
CAPTURES_FOLDER = "captures"
MERGED_FILE = "merged.ply"
POSES_FILE = "poses.yaml"
ROOM_FILE = "room.yaml"
OBJECT_FILE = "object.yaml"
OBJECT_CLOUD_FILE = "object.ply"
OBJECT_MESH_FILE = "object.glb"
ROOM_CLOUD_FILE = "room.ply"
ROOM_MESH_FILE = "room.glb"
NETWORK_FILE = "network.yaml"
NETWORK_CLOUD_FILE = "network.ply"
PLAN_FILE = "floorplan.svg"
PLAN_DXF_FILE = "floorplan.dxf"
DENSE_FILE = "dense.ply"
STEPS_FILE = "steps.yaml"
LOG_FILE = "scan.log"

CLOUD_FILES = (CLOUD_FILE, ROOM_CLOUD_FILE, OBJECT_CLOUD_FILE, NETWORK_CLOUD_FILE)

_OURS = {
    CALIBRATION_FILE,
    TRUTH_FILE,
    CLOUD_FILE,
    MERGED_FILE,
    POSES_FILE,
    ROOM_FILE,
    OBJECT_FILE,
    OBJECT_CLOUD_FILE,
    OBJECT_MESH_FILE,
    NETWORK_FILE,
    NETWORK_CLOUD_FILE,
    ROOM_CLOUD_FILE,
    ROOM_MESH_FILE,
    PLAN_FILE,
    PLAN_DXF_FILE,
    DENSE_FILE,
    STEPS_FILE,
    REPORT_FILE,
    REFUSAL_FILE,
    CAPTURE_FOLDER,
    CAPTURES_FOLDER,
    LOG_FILE,
    MATCHES_FILE,
}


def calibration_file(given: Path) -> Path:
    """The calibration of a result folder, or the file itself."""
    return given / CALIBRATION_FILE if given.is_dir() else given


def folder_of(result: Path, index: int, count: int) -> Path:
    """Return the folder of capture `index` of `count` in a result: the newest, which is the last, is at the top."""
    return result if index == count - 1 else result / CAPTURES_FOLDER / str(index + 1)


def default_out(stem: str, *, overwrite: bool) -> Path:
    """`scans/<stem>`, with -2, -3 … added if it exists and may not be overwritten."""
    out = Path("scans") / stem
    return out if overwrite else unused(out)


def path_beside(result: Path, ending: str) -> Path:
    """A path beside a result, derived from its name: the result folder itself is not changed."""
    folder = given_path(result)
    name = f"{folder.name}{ending}"
    return folder.parent / name if result.name in ("", ".", "..") else result.parent / name


def unused(path: Path) -> Path:
    """The path, or with -2, -3 … added one that neither exists nor is being made."""
    candidate, number = path, 1
    while candidate.exists() or is_held(candidate):
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


def refuse_occupied(out: Path, *, overwrite: bool | None = None) -> None:
    """Raise InputError if there is something at `out` already, other than an empty folder; `overwrite` as below."""
    if is_occupied(out):
        refuse_to_lose(out, overwrite=overwrite)


def is_occupied(path: Path) -> bool:
    """An empty folder is as good as none: nothing can be lost, and a rename replaces it."""
    if path.is_dir() and not path.is_symlink():
        return any(path.iterdir())
    return path.exists() or path.is_symlink()


def refuse_to_lose(out: Path, *, overwrite: bool | None) -> None:
    """Raise InputError unless `out` is a result and may be overwritten; None: there is no such option."""
    if not overwrite:
        instead = "" if overwrite is None else ", or replace an earlier result with --overwrite"
        raise InputError(f"{out}: already exists; choose another --out{instead}")
    if out.is_symlink() or not out.is_dir() or not (out / LOG_FILE).is_file():
        raise InputError(f"{out}: exists and is no result of an earlier scan, so it is not overwritten")
    foreign = sorted(path.name for path in out.iterdir() if path.name not in _OURS)
    if foreign:
        raise InputError(f"{out}: is not overwritten, because it holds files of others: {', '.join(foreign)}")
