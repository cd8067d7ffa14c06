"""Files that others have made: regular ones only, and none that would fill the memory or the disk.

The limits are stated in docs/formats.md. They leave room for what exists (photos of 200 megapixels, tens of millions of
points) and none for files that are small on disk and enormous in memory.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from scanner.errors import InputError

MOST_PIXELS = int(os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"])  # as scanner/__init__.py sets it, unless the user has
LONGEST_SIDE_PX = 65_535
MOST_IMAGE_BYTES = 3 * MOST_PIXELS  # in memory: as many pixels in 8-bit colour
MOST_IMAGE_FILE_BYTES = MOST_IMAGE_BYTES + 10_000_000  # stored uncompressed, with metadata
_MOST_UNPACKED_BYTES = 256_000_000
_MOST_UNPACKED_OF_DISK = 64  # ratio of unpacked to packed size that compression may reach beyond these bytes
_ON_DISK_BLOCK = 512  # unit of st_blocks on any file system
_PIECE_BYTES = 1 << 20
# Systems without pipes in the file system do not need it.
_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0)


def given_path(path: Path) -> Path:
    """Absolute path by the names that were given: a link is called by its own name, not by that of its target."""
    return Path(os.path.abspath(path))  # noqa: PTH100 - Path.resolve follows links, and Path.absolute keeps '..'


def _open_without_waiting(name: str, flags: int) -> int:
    return os.open(name, flags | _WITHOUT_WAITING)


def real_path(path: Path) -> Path:
    """Resolve links. A circle of links, for which `Path.resolve` raises RuntimeError, is left for the function that
    opens the file.
    """
    return Path(os.path.realpath(path))


@contextmanager
def opened(path: Path, most_bytes: int | None = None) -> Iterator[BinaryIO]:
    """A regular file, open for reading; what links lead to counts, and nothing waits for the other end of a pipe.

    Raises InputError if it is missing, cannot be read, is a folder, pipe or device, or is larger than `most_bytes`.
    """
    try:
        # Opened without blocking and checked afterwards, so that the checked file is the opened one.
        with open(path, "rb", opener=_open_without_waiting) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                kind = "a pipe" if stat.S_ISFIFO(status.st_mode) else "a device"
                raise InputError(f"{path}: is {kind}, expected a file")
            if most_bytes is not None and status.st_size > most_bytes:
                sizes = f"expected no more than {megabytes(most_bytes)}, found {megabytes(status.st_size)}"
                raise InputError(f"{path}: is too large: {sizes}")
            refuse_bomb(path, file, status.st_size)
            yield file
    except FileNotFoundError as error:
        raise InputError(f"{path}: cannot be read: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder, expected a file") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Read all of a regular file. Raises InputError as `opened` does."""
    with opened(path, most_bytes) as file:
        return file.read(min(os.fstat(file.fileno()).st_size, most_bytes))


def read_whole(path: Path) -> bytes:
    """All of a regular file that takes its place on the disk, however large. Raises InputError as `opened` does."""
    with opened(path) as file:
        return file.read()


def copy_given(source: Path, target: Path, most_bytes: int | None = None) -> None:
    """Copy a regular file, holes and all. Raises InputError as `opened` does, OSError if the copy cannot be written."""
    # Writing happens outside `opened`, which would report a full disk as an unreadable file.
    with target.open("wb") as copy:
        copy.writelines(_pieces(source, most_bytes))


def _pieces(path: Path, most_bytes: int | None) -> Iterator[bytes]:
    with opened(path, most_bytes) as file:
        while piece := file.read(_PIECE_BYTES):
            yield piece


def refuse_bomb(path: Path, file: BinaryIO, needed: int) -> None:
    """Raise InputError if the content takes `needed` bytes of memory, but hardly any on the disk."""
    status = os.fstat(file.fileno())
    # A small file may be stored in its directory entry without blocks; a sparse file has fewer blocks than its size.
    blocks = getattr(status, "st_blocks", None)
    on_disk = status.st_size if blocks is None else min(status.st_size, blocks * _ON_DISK_BLOCK)
    if needed > max(_MOST_UNPACKED_BYTES, _MOST_UNPACKED_OF_DISK * on_disk):
        raise InputError(
            f"{path}: would take {megabytes(needed)} of memory, but only {megabytes(on_disk)} of the disk: such a file "
            "holds no measurement"
        )


def refuse_more_pixels(width: int, height: int) -> None:
    """Raise ValueError for an image that would have more pixels than `MOST_PIXELS`."""
    if width * height > MOST_PIXELS:
        most = f"{MOST_PIXELS / 1e6:.0f} megapixels"
        raise ValueError(f"expected no more than {most}, found {width} × {height} pixels")


def megabytes(count: int) -> str:
    """A number of bytes, for people."""
    return f"{count / 1e6:,.0f} MB" if count >= 1e6 else f"{count:,} bytes"
