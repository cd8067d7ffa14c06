"""Captures of a network's pairs: folders named `<camera>-<projector>`."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import FACES, NO_FACE, Size
from calib.refusal import RefusalError
from calib.scene import FEWEST_STATIONS, TOO_FEW_STATIONS
from scanner.acquisition import decode_recording
from scanner.capture import CAPTURE_FILE, Recording, open_capture
from scanner.configuration import Config
from scanner.decoding import MirroredError
from scanner.errors import InputError
from scanner.io import given_path
from scanner.reconstruction import label
from scanner.results import CAPTURE_FOLDER, CAPTURES_FOLDER, Decoded
from scanner.ui import Terminal

Pair = tuple[str, str]

NO_CORNER_HERE = FindingKind(
    "no-corner-here",
    "A pair of a network shows no corner; it was joined by what it shares with others.",
)


@dataclass(frozen=True, eq=False)
class Captures:
    """What the pairs of a network recorded."""

    decoded: Mapping[Pair, Decoded]
    """By camera and projector, with labels where a corner was found; of several stations the first."""
    sizes: Mapping[str, Size]
    """Of all devices by name."""
    further: tuple[Mapping[Pair, Decoded], ...] = ()
    """Of further stations, between which what stands before the network was turned."""

    @property
    def stations(self) -> tuple[Mapping[Pair, Decoded], ...]:
        """All of them."""
        return (self.decoded, *self.further)


def read_pairs(folders: Sequence[Path], config: Config, terminal: Terminal) -> Captures:
    """Decode all captures, and find the corner in those that show one, where there is a single station.

    A folder of captures stands for all of them. Captures of one pair are of several stations, each in a folder of its
    own. Raises InputError for names that are none, a pair that a station lacks or has twice, a device whose images
    differ in size; RefusalError for two stations.
    """
    paths = [path for folder in folders for path in _pairs_in(folder)]
    if len(paths) < 2:
        raise InputError(f"a network needs two captures or more, found {len(paths)}; scan replay is for one")
    stations = _stations_of(paths)
    names = {pair for station in stations for pair in station}
    if len(names) < 2:
        raise InputError(
            f"all captures are of {'-'.join(min(names))}, and a network needs two pairs or more; scan calibrate is for "
            "several captures of one"
        )
    refuse_too_few(len(stations))
    roles = {name for name, _ in names} & {name for _, name in names}
    if roles:
        raise InputError(f"'{min(roles)}' names a camera in one capture and a projector in another; give it one role")
    sizes: dict[str, tuple[Size, Path]] = {}
    grid = config.projector.grid
    recordings = [
        {pair: open_capture(_recording_in(folder)).in_square_pixels(grid) for pair, folder in station.items()}
        for station in stations
    ]
    for pair, recording in (item for station in recordings for item in station.items()):
        for name, size in zip(pair, (recording.camera_size, recording.projector_size), strict=True):
            known, where = sizes.setdefault(name, (size, recording.folder))
            if known != size:
                raise InputError(
                    f"{recording.folder}: {name} has {size} pixels here and {known} in {where}; "
                    "a device keeps its size, or has another name"
                )
    decoded = [{pair: _decoded(recording, terminal) for pair, recording in station.items()} for station in recordings]
    return captures_of(decoded, {name: size for name, (size, _) in sizes.items()}, lambda _: config)


def refuse_too_few(stations: int) -> None:
    """Raise RefusalError for several stations that are too few to do without a corner."""
    if 1 < stations < FEWEST_STATIONS:
        raise RefusalError(
            TOO_FEW_STATIONS, f"{stations} stations without a corner determine no network.", TOO_FEW_STATIONS.remedy
        )


def captures_of(
    stations: Sequence[Mapping[Pair, Decoded]], sizes: Mapping[str, Size], config_of: Callable[[Pair], Config]
) -> Captures:
    """Stations that were decoded. A single one needs a corner, which is looked for."""
    first, *further = stations
    if not further:
        first = {pair: labelled(capture, config_of(pair)) for pair, capture in first.items()}
    return Captures(first, sizes, tuple(further))


def folder_of(folder: Path, station: int) -> Path:
    """Where in a `folder` of captures those of a station are: of the first in itself, of further ones in 2, 3, …"""
    return folder / str(station + 1) if station else folder


def _pairs_in(folder: Path) -> list[Path]:
    """The capture itself, or all captures in a folder, such as a station or a result."""
    if not folder.is_dir() or _is_capture(_recording_in(folder)):
        return [folder]
    within = folder / CAPTURES_FOLDER if (folder / CAPTURES_FOLDER).is_dir() else folder
    inside = [path for path in sorted(within.iterdir()) if path.is_dir()]
    pairs = [path for part in inside for path in _pairs_in(part) if _is_capture(_recording_in(path))]
    return pairs or [folder]


def _stations_of(folders: Sequence[Path]) -> list[dict[Pair, Path]]:
    """Captures by station: all of them or, where a pair is given several times, those that are in one folder."""
    counts = Counter(_pair_of(folder) for folder in folders)
    stations: dict[Path, dict[Pair, Path]] = {}
    for folder in folders:
        pair, place = _pair_of(folder), given_path(folder).parent if max(counts.values()) > 1 else Path()
        station = stations.setdefault(place, {})
        if pair in station:
            raise InputError(f"{folder}: given twice; each pair counts once at a station")
        station[pair] = folder
    for place, station in stations.items():
        if missing := set(counts) - set(station):
            camera, projector = min(missing)
            raise InputError(
                f"{place}: {camera}-{projector} is missing, which other stations have; captures of one station are in "
                "one folder, and each station has all pairs"
            )
    return [*stations.values()]


def _is_capture(folder: Path) -> bool:
    return (folder / CAPTURE_FILE).is_file()


def _recording_in(folder: Path) -> Path:
    """The capture folder itself, or that in what `scan network --config` keeps of a pair."""
    return folder / CAPTURE_FOLDER if (folder / CAPTURE_FOLDER).is_dir() else folder


def _pair_of(folder: Path) -> Pair:
    camera, dash, projector = given_path(folder).name.partition("-")
    if not (camera and dash and projector) or "-" in projector:
        raise InputError(
            f"{folder}: expected a folder named <camera>-<projector>, as in left-stage, with one hyphen; "
            "rename it after its devices"
        )
    return camera, projector


def _decoded(recording: Recording, terminal: Terminal) -> Decoded:
    try:
        return decode_recording(recording, terminal)
    except MirroredError as error:
        raise MirroredError(f"{recording.folder}: {error}") from error


def labelled(capture: Decoded, config: Config) -> Decoded:
    """With faces and further planes where there is a corner; others are joined by what they share with it."""
    try:
        (labelled_capture,) = label([capture], [capture], config)
    except RefusalError as refusal:
        finding = Finding(NO_CORNER_HERE, Severity.NOTE, f"no corner is found here: {refusal.reason}")
        return replace(capture, plane=None).with_findings(finding)
    face, plane = labelled_capture.matches.labels.clip(NO_FACE), labelled_capture.plane
    if plane is not None:
        further = (face == NO_FACE) & (plane >= 0) & ~np.isin(plane, np.unique(plane[face >= 0]))
        face = np.where(further, len(FACES) + plane, face).astype(np.int32)
    return labelled_capture.with_matches(labelled_capture.matches.with_faces(face), None)
