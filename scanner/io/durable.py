"""Folders and files that survive a power cut, are exchanged in one step, and are begun only if the disk has room."""

import ctypes
import errno
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from scanner.errors import StorageError

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
# Errors of file systems and kernels that do not support it.
_UNSUPPORTED = frozenset({errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP})


def sync(path: Path) -> None:
    """Wait until a file, or the list of names in a folder, is on the disk itself. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        sync_open(descriptor)
    finally:
        os.close(descriptor)


def sync_open(descriptor: int) -> None:
    """Sync an open file. Raises OSError."""
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _UNSUPPORTED:  # some network file systems cannot sync a folder
            raise


def sync_tree(folder: Path) -> None:
    """Everything in a folder. Raises OSError."""
    for path in folder.rglob("*"):
        sync(path)
    sync(folder)


def exchange(first: Path, second: Path) -> bool:
    """Let two folders change their names in one step (Linux's renameat2); False where that cannot be done.

    Raises OSError.
    """
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        return False
    if rename(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _UNSUPPORTED:
        return False
    raise OSError(number, os.strerror(number), str(first), None, str(second))


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


def missing_folders(folder: Path) -> list[Path]:
    """Return the folder and its parents that do not exist yet, deepest first. Raises OSError."""
    return [path for path in (folder, *folder.parents) if not path.exists()]


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders, deepest first; missing and non-empty ones are skipped."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
