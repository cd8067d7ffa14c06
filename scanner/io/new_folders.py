"""Folders that are created for a result, and removed if it fails."""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


def missing_folders(folder: Path) -> list[Path]:
    """Return the folder and its parents that do not exist yet, deepest first. Raises OSError."""
    return [path for path in (folder, *folder.parents) if not path.exists()]


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders, deepest first; missing and non-empty ones are skipped."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
