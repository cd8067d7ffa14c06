"""Checks for disk space before anything is written."""

import os
from pathlib import Path

from scanner.errors import StorageError

# Reserve for text files, folders and the file system itself.
_MARGIN_BYTES = 4_000_000


def require_space(folder: Path, count: int, total_bytes: int, what: str) -> None:
    """Raise StorageError if the disk of a `folder`, which may not be there yet, cannot take `count` more files."""
    place = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    disk = os.statvfs(place)
    free, needed = disk.f_bavail * disk.f_frsize, total_bytes + _MARGIN_BYTES
    if free < needed:
        raise StorageError(
            f"{place}: {what} needs up to {_size(needed)}, but {_size(free)} are free; make room there, or choose "
            "another --out"
        )
    if disk.f_files and disk.f_favail < count:
        raise StorageError(
            f"{place}: {what} needs {count} files, but its file system takes only {disk.f_favail} more (inodes); "
            "remove files there, or choose another --out"
        )


def _size(number: int) -> str:
    return f"{number / 1e9:.1f} GB" if number >= 1e9 else f"{number / 1e6:.0f} MB"
