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
MOST_IMAGE_BYTES = 3 * MOST_PIXELS  # as it lies in memory: as many pixels in 8-bit colour
MOST_IMAGE_FILE_BYTES = MOST_IMAGE_BYTES + 10_000_000  # stored as it is, with what is said about it
_MOST_UNPACKED_BYTES = 256_000_000
_MOST_UNPACKED_OF_DISK = 64  # what is beyond these bytes takes its place on the disk, too, but for compression
_ON_DISK_BLOCK = 512  # of st_blocks, whatever the file system's is
_PIECE_BYTES = 1 << 20
# Where there is no such thing as a pipe among files, there is no need not to wait for it.
_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0)


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
        # Opened without waiting and looked at afterwards: what is opened is what was looked at.
        with open(path, "rb", opener=_open_without_waiting) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                kind = "a pipe" if stat.S_ISFIFO(found.st_mode) else "a device"
                raise InputError(f"{path}: is {kind}, expected a file")
            if most_bytes is not None and found.st_size > most_bytes:
                sizes = f"expected no more than {megabytes(most_bytes)}, found {megabytes(found.st_size)}"
                raise InputError(f"{path}: is too large: {sizes}")
            refuse_bomb(path, file, found.st_size)
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
    # What is written is written outside of `opened`, which would take a full disk for a file that cannot be read.
    with target.open("wb") as copy:
        copy.writelines(_pieces(source, most_bytes))


def _pieces(path: Path, most_bytes: int | None) -> Iterator[bytes]:
    with opened(path, most_bytes) as file:
        while piece := file.read(_PIECE_BYTES):
            yield piece


def refuse_bomb(path: Path, file: BinaryIO, needed: int) -> None:
    """Raise InputError if what is read from the file takes `needed` bytes of memory, out of hardly any on the disk."""
    found = os.fstat(file.fileno())
    # A small file may be kept in its directory entry, and has no block; a file with holes has fewer than its size.
    blocks = getattr(found, "st_blocks", None)
    on_disk = found.st_size if blocks is None else min(found.st_size, blocks * _ON_DISK_BLOCK)
    if needed > max(_MOST_UNPACKED_BYTES, _MOST_UNPACKED_OF_DISK * on_disk):
        raise InputError(
            f"{path}: would take {megabytes(needed)} of memory, and has {megabytes(on_disk)} on the disk: this is no "
            "measurement but a file that unpacks to nothing much"
        )


def refuse_more_pixels(width: int, height: int) -> None:
    """Raise ValueError for an image that would have more pixels than `MOST_PIXELS`."""
    if width * height > MOST_PIXELS:
        most = f"{MOST_PIXELS / 1e6:.0f} megapixels"
        raise ValueError(f"expected no more than {most}, found {width} × {height} pixels")


def megabytes(count: int) -> str:
    """A number of bytes, for people."""
    return f"{count / 1e6:,.0f} MB" if count >= 1e6 else f"{count:,} bytes"
