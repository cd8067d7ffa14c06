"""Images that are written and read by rows, few of which are in memory at once: float TIFF, and scratch."""

import os
import struct
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.numerics import in_parallel, in_slices, slices_of

Result = TypeVar("Result")

_PIXELS_AT_ONCE, _PIXELS_OF_SLICE = 1 << 20, 1 << 16

# TIFF 6.0, and BigTIFF for files whose places take more than 32 bits.
_SHORT, _LONG, _LONG8 = (3, "<u2"), (4, "<u4"), (16, "<u8")
_STRIP_BYTES = 1 << 20
_LARGEST_CLASSIC = (1 << 32) - (1 << 24)
_UNCOMPRESSED, _CONTIGUOUS, _FLOAT = 1, 1, 3
_GREY, _RGB = 1, 2


def in_rows(shape: tuple[int, ...], work: Callable[[slice], Result]) -> list[Result]:
    """Return the results of `work` for slices of the rows of an image (H, W, …), in order; some run in parallel."""
    return in_slices(shape[0], _rows_of(shape, _PIXELS_OF_SLICE), work)


def by_rows(shape: tuple[int, ...], work: Callable[[slice], Result]) -> Iterator[Result]:
    """Yield the same, of which few are in memory at once."""
    for band in slices_of(shape[0], _rows_of(shape, _PIXELS_AT_ONCE)):
        parts = slices_of(band.stop - band.start, _rows_of(shape, _PIXELS_OF_SLICE))
        yield from in_parallel(work, [slice(band.start + part.start, band.start + part.stop) for part in parts])


def _rows_of(shape: tuple[int, ...], pixels: int) -> int:
    return max(1, pixels // shape[1])


class RowFile:
    """An image (H, W) or (H, W, C) in an open file, from `offset` on. Threads may read and write it side by side."""

    def __init__(self, file: BinaryIO, shape: tuple[int, ...], dtype: type[np.generic], offset: int = 0) -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        self._file, self._offset = file, offset
        self._row_bytes = prod(shape[1:]) * self.dtype.itemsize

    def write(self, rows: slice, values: NDArray[np.generic]) -> None:
        """Write some rows, (n, W) or (n, W, C). Raises OSError."""
        data: memoryview = np.ascontiguousarray(values, self.dtype).reshape(-1).view(np.uint8).data
        place = self._offset + rows.start * self._row_bytes
        while data:
            count = os.pwrite(self._file.fileno(), data, place)
            data, place = data[count:], place + count

    def write_all(self, image: NDArray[np.generic]) -> None:
        """Write the whole image. Raises OSError."""
        self.write(slice(0, self.shape[0]), image)

    def read(self, rows: slice) -> NDArray[np.float32]:
        """Rows that were written, (n, W) or (n, W, C). Raises OSError."""
        image: NDArray[np.float32] = np.empty((rows.stop - rows.start, *self.shape[1:]), self.dtype)
        data, place = image.reshape(-1).view(np.uint8).data, self._offset + rows.start * self._row_bytes
        while data:
            count = os.preadv(self._file.fileno(), [data], place)
            if count == 0:
                raise OSError(f"rows {rows.start} to {rows.stop} were not written")
            data, place = data[count:], place + count
        return image

    def read_all(self) -> NDArray[np.float32]:
        """The whole image."""
        return self.read(slice(0, self.shape[0]))


@contextmanager
def scratch_rows(folder: Path, shape: tuple[int, ...], dtype: type[np.generic] = np.float32) -> Iterator[RowFile]:
    """An image in a file without a name, which takes its place on the disk of `folder` until the block ends."""
    with tempfile.TemporaryFile(dir=folder) as file:
        yield RowFile(file, shape, dtype)


@contextmanager
def tiff_rows(path: Path, shape: tuple[int, ...]) -> Iterator[RowFile]:
    """A new TIFF file of floats, uncompressed: (H, W), or (H, W, 3) as red, green and blue."""
    header = _tiff_header(shape)
    with path.open("w+b") as file:
        file.write(header)
        file.flush()
        yield RowFile(file, shape, np.float32, len(header))


def _tiff_header(shape: tuple[int, ...]) -> bytes:
    """All that comes before the pixels."""
    height, width, channels = (*shape, 1)[:3]
    row_bytes = 4 * width * channels
    is_big = height * row_bytes > _LARGEST_CLASSIC
    per_strip = min(height, max(1, _STRIP_BYTES // row_bytes))
    tops = np.arange(0, height, per_strip, dtype=np.uint64)
    counts: NDArray[np.uint64] = np.minimum(per_strip, height - tops) * row_bytes
    place_type = _LONG8 if is_big else _LONG

    def header_for(first: int) -> bytes:
        return _directory(
            [
                (256, _LONG, [width]),
                (257, _LONG, [height]),
                (258, _SHORT, [32] * channels),
                (259, _SHORT, [_UNCOMPRESSED]),
                (262, _SHORT, [_GREY if channels == 1 else _RGB]),
                (273, place_type, first + tops * row_bytes),
                (277, _SHORT, [channels]),
                (278, _LONG, [per_strip]),
                (279, place_type, counts),
                (284, _SHORT, [_CONTIGUOUS]),
                (339, _SHORT, [_FLOAT] * channels),
            ],
            is_big=is_big,
        )

    return header_for(len(header_for(0)))


def _directory(
    entries: Sequence[tuple[int, tuple[int, str], Sequence[int] | NDArray[np.uint64]]], *, is_big: bool
) -> bytes:
    """The file's beginning and its only directory; values that do not fit into their entry follow it."""
    start = struct.pack("<2sHHHQ", b"II", 43, 8, 0, 16) if is_big else struct.pack("<2sHI", b"II", 42, 8)
    count_format, place_format = ("<Q", "<Q") if is_big else ("<H", "<I")
    entry_format, within = ("<HHQ", 8) if is_big else ("<HHI", 4)
    entry_bytes = struct.calcsize(entry_format) + within
    end = len(start) + struct.calcsize(count_format) + len(entries) * entry_bytes + within
    directory, further = [start, struct.pack(count_format, len(entries))], b""
    for tag, (number, kind), values in entries:
        data = np.asarray(values).astype(kind).tobytes()
        directory.append(struct.pack(entry_format, tag, number, len(values)))
        if len(data) <= within:
            directory.append(data.ljust(within, b"\0"))
        else:
            directory.append(struct.pack(place_format, end + len(further)))
            further += data.ljust(-(-len(data) // 8) * 8, b"\0")
    return b"".join([*directory, bytes(within), further])
