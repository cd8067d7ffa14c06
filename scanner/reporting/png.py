"""Pictures as PNG (ISO/IEC 15948): of few colours by a palette, which makes a map a quarter of the work; and RGBA."""

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_INDEXED, _RGBA = 3, 6
_PLAIN, _SUB = 0, 1
# Higher levels take several times as long for a few per cent.
_LEVEL = 1


@dataclass(frozen=True)
class IndexedPicture:
    """`index` (H, W) into `palette` (n, 4), RGBA of at most 256 colours."""

    index: Pixels
    palette: Pixels

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns."""
        return self.index.shape

    @property
    def rgba(self) -> Pixels:
        """The same with the colours written out, (H, W, 4)."""
        return self.palette[self.index]


def png_of(picture: IndexedPicture | Pixels) -> bytes:
    """The file of a picture with a palette, or of RGBA (H, W, 4)."""
    if isinstance(picture, IndexedPicture):
        colours = _chunk(b"PLTE", picture.palette[:, :3].tobytes()) + _chunk(b"tRNS", picture.palette[:, 3].tobytes())
        return _file(picture.shape, _INDEXED, colours, _rows(picture.index, _PLAIN))
    height, width = picture.shape[:2]
    difference = picture.copy()
    difference[:, 1:] -= picture[:, :-1]
    return _file((height, width), _RGBA, b"", _rows(difference.reshape(height, 4 * width), _SUB))


def _rows(values: Pixels, filtered: int) -> Pixels:
    """Each row with the number of its filter in front."""
    rows = np.empty((values.shape[0], values.shape[1] + 1), np.uint8)
    rows[:, 0], rows[:, 1:] = filtered, values
    return rows


def _file(shape: tuple[int, ...], colour_type: int, colours: bytes, rows: Pixels) -> bytes:
    # Eight bits to a sample; the only compression and filter method that there is; not interlaced.
    header = struct.pack(">IIBBBBB", shape[1], shape[0], 8, colour_type, 0, 0, 0)
    data = _chunk(b"IDAT", zlib.compress(rows.data, _LEVEL))
    return _SIGNATURE + _chunk(b"IHDR", header) + colours + data + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
