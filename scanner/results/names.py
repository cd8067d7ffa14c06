"""The files in a result folder of each kind, and which names for a folder are free."""

from collections.abc import Mapping
from dataclasses import dataclass
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


@dataclass(frozen=True)
class ResultKind:
    """What a result can be of, and its files."""

    listing: str
    """The file by which it is recognised: with the poses of its scans, or the matches of a single one."""
    cloud: str
    mesh: str | None
    """The file of a mesh under pictures; None without one."""
    files: Mapping[str, str]
    """Files and folders by name: what each is, as the report says."""

    @property
    def is_joined(self) -> bool:
        """Whether it is of stations: a room or an object."""
        return self.mesh is not None


_OF_EVERY_KIND = {
    TRUTH_FILE: "the simulated rig's true calibration",
    LOG_FILE: "what the program did, step by step",
}
CORNER = ResultKind(
    MATCHES_FILE,
    CLOUD_FILE,
    None,
    {
        CALIBRATION_FILE: "intrinsics of both devices, and the motion between them",
        REFUSAL_FILE: "machine-readable: why nothing was calibrated",
        CLOUD_FILE: "the point cloud with normals and colours, for MeshLab, CloudCompare or Open3D",
        MATCHES_FILE: "camera and projector pixels of every match, and its face",
        MERGED_FILE: "the clouds of all captures in one, in the corner's frame",
        POSES_FILE: "where the camera of each capture stood in that frame",
        DENSE_FILE: "a point for every pixel of the first two photos that was matched, in the first photo's frame",
        CAPTURES_FOLDER: "the other captures that were calibrated with this one, each a result of its own",
        CAPTURE_FOLDER: "the recording: replay it with scan replay",
        **_OF_EVERY_KIND,
    },
)
ROOM = ResultKind(
    ROOM_FILE,
    ROOM_CLOUD_FILE,
    ROOM_MESH_FILE,
    {
        ROOM_CLOUD_FILE: "one cloud of the whole room, with normals and colours",
        ROOM_MESH_FILE: "one mesh of it",
        ROOM_FILE: "where every station stood, the planes, and their sigmas",
        CALIBRATION_FILE: "intrinsics of both devices and the motion between them, from all stations together",
        PLAN_FILE: "the plan below",
        PLAN_DXF_FILE: "the same for CAD programs",
        CAPTURES_FOLDER: "the stations, each a result of its own",
        **_OF_EVERY_KIND,
    },
)
OBJECT = ResultKind(
    OBJECT_FILE,
    OBJECT_CLOUD_FILE,
    OBJECT_MESH_FILE,
    {
        OBJECT_CLOUD_FILE: "one cloud of all stations, with normals and colours",
        OBJECT_MESH_FILE: "one mesh of it, under the stations' pictures",
        OBJECT_FILE: "the poses of the stations relative to the thing, with sigmas; its volume and area",
        CALIBRATION_FILE: "the rig, as it was given",
        CAPTURES_FOLDER: "the stations, each a result of its own",
        **_OF_EVERY_KIND,
    },
)
NETWORK = ResultKind(
    NETWORK_FILE,
    NETWORK_CLOUD_FILE,
    None,
    {
        NETWORK_CLOUD_FILE: "one cloud from all cameras, with normals and colours",
        NETWORK_FILE: "every device with its intrinsics and pose, the planes, and their sigmas",
        CAPTURES_FOLDER: "the recordings of the pairs, and what was decoded",
        LOG_FILE: _OF_EVERY_KIND[LOG_FILE],
    },
)
KINDS = (ROOM, OBJECT, NETWORK, CORNER)

_OURS = {REPORT_FILE, STEPS_FILE, *(name for kind in KINDS for name in kind.files)}


def kind_of(folder: Path) -> ResultKind:
    """The kind of a result folder: of a corner if nothing else is in it."""
    return next((kind for kind in KINDS if (folder / kind.listing).is_file()), CORNER)


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
