"""Writing PNG on all processors, so that a camera need not wait.

The pixels of a PNG are one deflate stream, but a stream may consist of independently compressed parts (RFC 1950, 1951):
strips of the image, one per thread. One filter for all rows, the difference from the pixel to the left, suits noise and
stripes best. Noise has no repetitions, so only Huffman codes are used; computed images repeat their slopes.
"""

import io
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image, in_slices, processors
from scanner.io.image_size import PNG_START

_COLOUR_TYPES = {1: 0, 3: 2, 4: 6}  # by channels: grey, RGB, RGB with transparency
_DEPTHS = {np.dtype(np.uint8): 8, np.dtype(np.uint16): 16}
_LEFT = 1  # the filter's number (PNG, section 9.2)
_ZLIB_HEADER = b"\x78\x01"  # deflate, a window of 32 kB, fastest
_WINDOW_BITS, _MEMORY = -15, 9  # without header and check sum
_LEAST_BYTES = 1 << 18  # least bytes per strip
_STRIPS_PER_PROCESSOR = 2  # the other processors are busy too
_ADLER = 65521


def write_png(path: Path, image: Image) -> None:
    """Write an image, (H, W) or (H, W, 3 or 4) in OpenCV's order of colours, of 8 or 16 bits. Raises OSError."""
    path.write_bytes(png_of(image))


def png_of(image: Image) -> bytes:
    """The bytes of that file. Raises ValueError for another shape or type."""
    file = io.BytesIO()
    png = PngFile(file, image.shape, image.dtype)
    height, width = image.shape[:2]
    strips = processors() * _STRIPS_PER_PROCESSOR
    rows = max(-(-height // strips), -(-_LEAST_BYTES // (width * png.pixel_bytes)))
    for strip in in_slices(height, rows, lambda at: png.compressed(image[at], is_last=at.stop == height)):
        png.append(strip)
    return file.getvalue()


@dataclass(frozen=True)
class PngRows:
    """Compressed rows of a PNG: `chunk`, as it is in the file, and the check sum of its content."""

    chunk: bytes
    checked: "_CheckSum"


class PngFile:
    """A PNG that is written by rows. Raises ValueError for an image of another shape or type than `write_png` takes.

    `is_computed`: the image has slopes without noise, in which repetitions are worth a search.
    """

    def __init__(
        self, file: BinaryIO, shape: tuple[int, ...], dtype: np.dtype[np.generic], *, is_computed: bool = False
    ) -> None:
        channels = 1 if len(shape) == 2 else shape[2] if len(shape) == 3 else 0
        if channels not in _COLOUR_TYPES or dtype not in _DEPTHS or not np.prod(shape):
            raise ValueError(f"an image of shape {shape} and type {dtype} cannot be written as PNG")
        height, width = shape[:2]
        self.pixel_bytes = channels * dtype.itemsize
        self._file = file
        self._strategy = zlib.Z_DEFAULT_STRATEGY if is_computed else zlib.Z_HUFFMAN_ONLY
        self._checked = _CheckSum(1, 0)
        self._whole = height * (1 + width * self.pixel_bytes)
        header = struct.pack(">IIBBBBB", width, height, _DEPTHS[dtype], _COLOUR_TYPES[channels], 0, 0, 0)
        file.write(PNG_START + _chunk(b"IHDR", header) + _chunk(b"IDAT", _ZLIB_HEADER))

    def compressed(self, rows: Image, *, is_last: bool) -> PngRows:
        """Compress some rows; several threads may."""
        return _compressed(rows, self.pixel_bytes, self._strategy, is_last=is_last)

    def append(self, rows: PngRows) -> None:
        """Write the next rows; the file is complete after the last. Raises OSError."""
        self._file.write(rows.chunk)
        self._checked = self._checked.followed_by(rows.checked)
        if self._checked.length == self._whole:
            self._file.write(_chunk(b"IDAT", struct.pack(">I", self._checked.adler)) + _chunk(b"IEND", b""))


@dataclass(frozen=True)
class _CheckSum:
    """The Adler-32 checksum of `length` bytes."""

    adler: int
    length: int

    def followed_by(self, following: "_CheckSum") -> "_CheckSum":
        """Return the checksum of these bytes followed by others (RFC 1950, section 9, whose two sums are `low` and
        `high`).
        """
        (high, low), (other_high, other_low) = (divmod(check_sum.adler, 1 << 16) for check_sum in (self, following))
        joined = (low + other_low - 1) % _ADLER
        joined += (high + other_high + following.length * (low - 1)) % _ADLER << 16
        return _CheckSum(joined, self.length + following.length)


def _compressed(strip: Image, pixel_bytes: int, strategy: int, *, is_last: bool) -> PngRows:
    rows = _bytes_of(strip)
    filtered = np.empty((len(rows), 1 + rows.shape[1]), np.uint8)
    filtered[:, 0], filtered[:, 1 : 1 + pixel_bytes] = _LEFT, rows[:, :pixel_bytes]
    np.subtract(rows[:, pixel_bytes:], rows[:, :-pixel_bytes], out=filtered[:, 1 + pixel_bytes :])
    deflate = zlib.compressobj(1, zlib.DEFLATED, _WINDOW_BITS, _MEMORY, strategy)
    # All parts but the last end at a whole byte, without an end mark.
    data = deflate.compress(filtered.data) + deflate.flush(zlib.Z_FINISH if is_last else zlib.Z_SYNC_FLUSH)
    return PngRows(_chunk(b"IDAT", data), _CheckSum(zlib.adler32(filtered.data), filtered.size))


def _bytes_of(strip: Image) -> NDArray[np.uint8]:
    """Rows (H, bytes), colours in PNG's order, the higher byte of a number first."""
    if strip.ndim == 3:
        strip = strip[..., [2, 1, 0, 3][: strip.shape[2]]]
    ordered = np.ascontiguousarray(strip.astype(strip.dtype.newbyteorder(">"), copy=False))
    return ordered.reshape(len(strip), -1).view(np.uint8)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
