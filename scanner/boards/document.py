"""Folders on the command line → captures."""

from collections.abc import Sequence
from pathlib import Path

from scanner.capture import CAPTURE_FILE, Recording, open_capture
from scanner.errors import InputError
from scanner.io import refuse_other_sizes


def read_folders(folders: Sequence[Path]) -> list[Recording]:
    """The captures in folders, or in folders of those, in the order of their names. Raises InputError.

    They come from one unchanged rig, so their sizes are the same, and each is given once.
    """
    recordings: list[Recording] = []
    for folder in folders:
        recordings += [open_capture(place) for place in _captures_in(folder)]
    places = [recording.folder.resolve() for recording in recordings]
    for i, place in enumerate(places):
        if place in places[:i]:
            raise InputError(f"{recordings[i].folder}: given twice; a board counted twice would make sigmas too small")
    first, why = recordings[0], ": captures that are calibrated together come from one unchanged rig"
    for later in recordings[1:]:
        sizes, expected = ((capture.camera_size, capture.projector_size) for capture in (later, first))
        refuse_other_sizes(later.folder, sizes, expected, f"that of {first.folder}", why)
    return recordings


def _captures_in(folder: Path) -> list[Path]:
    if not (folder / CAPTURE_FILE).exists() and folder.is_dir():
        inner = sorted(place.parent for place in folder.glob(f"*/{CAPTURE_FILE}"))
        if inner and not (folder / "capture" / CAPTURE_FILE).exists():
            return inner
    return [folder]
