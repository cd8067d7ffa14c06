"""Files that appear completely or not at all, also several together, and replace others only on request.

They are written under hidden names, `.TOKEN.partial.NAME`. `.TOKEN.names` beside them is locked by the writing process,
and lists them when all are complete. From then on, the next process that writes to the folder completes an interrupted
replacement. A partial file without that list is removed.

Folders and files survive a power cut, are exchanged in one step, and are begun only if the disk has room.
"""

import ctypes
import errno
import fcntl
import logging
import os
import secrets
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from scanner.errors import InputError, StorageError, cannot_write
from scanner.interruption import finishing

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


log = logging.getLogger(__name__)

_LOCK, _PARTIAL = ".names", ".partial."
_TOKEN_BYTES = 6
_MOST_BYTES = 1 << 16  # bytes of names
_NOT_OPEN = -1


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise InputError if `path` is anything but a file that may be replaced, after settling leftovers.

    Raises StorageError if they cannot be settled.
    """
    if path.parent.exists() and not path.parent.is_dir():
        raise InputError(f"{path.parent}: is a file, expected a folder to write into: choose another --out")
    _settle(path.parent)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected the name of a file to write")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: already exists; choose another --out, or replace it with --overwrite")


@contextmanager
def new_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """A hidden file to write, which becomes `path`; otherwise like `new_files`."""
    with new_files(path.parent, [path.name], overwrite=overwrite) as (partial,):
        yield partial


@contextmanager
def new_files(folder: Path, names: Sequence[str], *, overwrite: bool) -> Iterator[list[Path]]:
    """Hidden files in a folder to write into; they get their `names` when the block ends well, and vanish if not.

    Folders on the way are made, and vanish with them. Raises InputError if one exists and may not be replaced, or no
    file can be there; StorageError if the disk does not take it.
    """
    for name in names:
        refuse_existing(folder / name, overwrite=overwrite)
    with _made(folder):
        partial = _Partial.new(folder)
        try:
            partial.begin()
            yield [partial.path(name) for name in names]
            with finishing():
                partial.publish(names)
        except OSError as error:
            raise cannot_write(folder / names[0], error) from error
        finally:
            with finishing(ending=True):
                partial.end()


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Create a folder and its parents; after a failure, those that were created are removed."""
    missing: list[Path] = []
    try:
        try:
            missing = missing_folders(folder)
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(folder, error, "made") from error
        yield
    except BaseException:
        remove_empty(missing)
        raise


class _Partial:
    """Files that are being written, by what their names have in common, and the lock on them."""

    def __init__(self, lock: Path) -> None:
        self._lock = lock
        self._file = _NOT_OPEN

    @classmethod
    def new(cls, folder: Path) -> "_Partial":
        """A set that has not begun."""
        return cls(folder / f".{secrets.token_hex(_TOKEN_BYTES)}{_LOCK}")

    def begin(self) -> None:
        """Take the lock. Raises OSError."""
        self._file = os.open(self._lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        with suppress(OSError):  # a file system without locks, where nothing is settled
            fcntl.flock(self._file, fcntl.LOCK_EX)
        if not self._lock.exists():  # another program took it for a leftover
            os.close(self._file)
            self.begin()

    def take_over(self) -> bool:
        """Take the lock of a process that was killed. Returns False if that process is alive, or if this cannot be
        determined. Raises OSError.
        """
        self._file = os.open(self._lock, os.O_RDWR | os.O_NOFOLLOW)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            return False
        return True

    def path(self, name: str) -> Path:
        """The path of the file until it is complete."""
        return self._lock.with_name(f"{self._stem}{_PARTIAL}{name}")

    def publish(self, names: Sequence[str]) -> None:
        """Give all files their names. Raises OSError."""
        for name in names:
            sync(self.path(name))
        if len(names) > 1:
            os.pwrite(self._file, "".join(f"{name}\n" for name in names).encode(), 0)
            os.fsync(self._file)
        for name in names:
            self.path(name).replace(self._lock.with_name(name))

    def settle(self) -> str:
        """Complete what was finished, and remove the rest; a sentence about it, if there was anything."""
        whole = os.pread(self._file, _MOST_BYTES, 0).decode(errors="replace").splitlines()
        unfinished = sorted(path.name.partition(_PARTIAL)[2] for path in self._partial_files())
        for name in unfinished:
            with suppress(OSError):
                if name in whole:
                    self.path(name).replace(self._lock.with_name(name))
        self.end()
        names, folder = ", ".join(unfinished), self._lock.parent
        if unfinished and whole:
            return f"A program was killed after its files were complete: {names} in {folder} are in place now."
        return f"Incomplete files of a killed program were removed: {names} in {folder}." if unfinished else ""

    def end(self) -> None:
        """Remove the lock and every file that has not been moved to its final name."""
        with suppress(OSError):  # a disk error has been reported already
            for path in self._partial_files():
                path.unlink(missing_ok=True)
            self._lock.unlink(missing_ok=True)
        with suppress(OSError):
            os.close(self._file)

    @property
    def _stem(self) -> str:
        return self._lock.name.removesuffix(_LOCK)

    def _partial_files(self) -> list[Path]:
        return list(self._lock.parent.glob(f"{self._stem}{_PARTIAL}*"))


def _settle(folder: Path) -> None:
    """Settle what programs that were killed have left in a folder. Raises StorageError, InputError."""
    for lock in folder.glob(f".{'[0-9a-f]' * (2 * _TOKEN_BYTES)}{_LOCK}"):
        partial = _Partial(lock)
        try:
            if lock.is_file() and partial.take_over() and (sentence := partial.settle()):
                log.warning("%s", sentence)
        except FileNotFoundError:
            continue  # its process has just ended
        except OSError as error:
            raise cannot_write(lock, error, "tidied up") from error
