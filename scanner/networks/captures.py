"""Captures of a network's pairs: folders named `<camera>-<projector>`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import FACES, NO_FACE, Size
from calib.refusal import RefusalError
from scanner.acquisition import decode_recording
from scanner.capture import Recording, open_capture
from scanner.configuration import Config
from scanner.decoding import MirroredError
from scanner.errors import InputError
from scanner.io import given_path
from scanner.reconstruction import label
from scanner.results import CAPTURE_FOLDER, Decoded
from scanner.ui import Terminal

Pair = tuple[str, str]

NO_CORNER_HERE = FindingKind(
    "no-corner-here",
    "A pair of a network shows no corner; it was joined by what it shares with others.",
)


@dataclass(frozen=True, eq=False)
class Captures:
    """`decoded`: by camera and projector, with labels where a corner was found. `sizes` of all devices by name."""

    decoded: Mapping[Pair, Decoded]
    sizes: Mapping[str, Size]


def read_pairs(folders: Sequence[Path], config: Config, terminal: Terminal) -> Captures:
    """Decode all captures, and find the corner in those that show one.

    Raises InputError for names that are none, a pair that is given twice, a device whose images differ in size.
    """
    if len(folders) < 2:
        raise InputError(f"a network needs two captures or more, found {len(folders)}; scan replay is for one")
    named: dict[Pair, Path] = {}
    for folder in folders:
        pair = _pair_of(folder)
        if pair in named:
            raise InputError(f"{folder}: {named[pair]} is of {pair[0]} and {pair[1]}, too; each pair counts once")
        named[pair] = folder
    roles = {name for name, _ in named} & {name for _, name in named}
    if roles:
        raise InputError(f"'{min(roles)}' names a camera in one capture and a projector in another; give it one role")
    sizes: dict[str, tuple[Size, Path]] = {}
    grid = config.projector.grid
    recordings = {pair: open_capture(_recording_in(folder)).in_square_pixels(grid) for pair, folder in named.items()}
    for pair, recording in recordings.items():
        for name, size in zip(pair, (recording.camera_size, recording.projector_size), strict=True):
            known, where = sizes.setdefault(name, (size, recording.folder))
            if known != size:
                raise InputError(
                    f"{recording.folder}: {name} has {size} pixels here and {known} in {where}; "
                    "a device keeps its size, or has another name"
                )
    decoded = {pair: labelled(_decoded(recording, terminal), config) for pair, recording in recordings.items()}
    return Captures(decoded, {name: size for name, (size, _) in sizes.items()})


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
        (found,) = label([capture], [capture], config)
    except RefusalError as refusal:
        finding = Finding(NO_CORNER_HERE, Severity.NOTE, f"no corner is found here: {refusal.reason}")
        return replace(capture, plane=None).with_findings(finding)
    face, plane = found.matches.labels.clip(NO_FACE), found.plane
    if plane is not None:
        further = (face == NO_FACE) & (plane >= 0) & ~np.isin(plane, np.unique(plane[face >= 0]))
        face = np.where(further, len(FACES) + plane, face).astype(np.int32)
    return found.with_matches(found.matches.with_faces(face), None)
