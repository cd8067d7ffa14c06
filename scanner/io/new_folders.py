"""Folders that are made on the way to a result, and vanish where nothing comes of it."""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


def missing_folders(folder: Path) -> list[Path]:
    """Return the folder and its parents that do not exist yet, deepest first. Raises OSError."""
    return [each for each in (folder, *folder.parents) if not each.exists()]


def remove_empty(folders: Iterable[Path]) -> None:
    """Take folders away, deepest first; those that are not there, or that somebody has put something in, stay so."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
