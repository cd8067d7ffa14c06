"""The size of an image, and the memory to decode it, from the header of its file alone.

OpenCV has no such function. Pillow has one, but it reads more than the size, and fails on parts that OpenCV never
reads, such as a PNG's broken comment: the content of a file must not select the reader that measures it. So the common
formats are measured here. Decoders of some formats hold more than the pixels: all coefficients of a progressive JPEG,
32-bit integers for JPEG 2000.
"""

import re
import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from math import ceil
from typing import Any

from PIL import Image, TiffImagePlugin

from calib.geometry import Size
from hw.jpeg import FRAMES, START

SCAN, END = 0xDA, 0xD9
PROGRESSIVE = {0xC2, 0xC6, 0xCA, 0xCE}
_ALONE = {0x01, *range(0xD0, 0xD9)}
# Within compressed data a 0xFF is followed by 0, or is a restart marker.
_MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")


def segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Marker and content of each segment up to the end of the picture; data between them are skipped."""
    at = 2
    while match := _MARKER.search(data, at):
        marker, at = data[match.start() + 1], match.end()
        if marker == END:
            return
        if marker in _ALONE:
            continue
        length = int.from_bytes(data[at : at + 2], "big")
        yield marker, data[at + 2 : at + length]
        at += max(2, length)


# For formats that Pillow cannot read.
UNREADABLE = (OSError, SyntaxError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RuntimeError)
PNG_START = b"\x89PNG\r\n\x1a\n"
_TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_CODESTREAM = b"\xff\x4f\xff\x51"
_COLOUR = 3  # also for palettes, which OpenCV expands
_WITH_ALPHA = 4
# By the colour type in a PNG's header (ISO/IEC 15948, table 11.1).
_PNG_CHANNELS = {0: 1, 2: _COLOUR, 3: _COLOUR, 4: _WITH_ALPHA, 6: _WITH_ALPHA}
_MODES = {"1": 1, "L": 1, "I": 1, "F": 1, "I;16": 1, "I;16B": 1, "I;16L": 1, "LA": 4, "RGBA": 4, "PA": 4, "CMYK": 4}
_WIDTH, _HEIGHT, _BITS, _PHOTOMETRIC, _SAMPLES = 256, 257, 258, 262, 277  # tags of TIFF 6.0
_PALETTE = 3
_IN_A_BYTE = 255
_HELD_BESIDE = {
    "JPEG2000": 4,
    "AVIF": 4,
    "GIF": 2,
    "WEBP": 1,
}  # bytes per channel that a decoder needs beyond the picture

# Pillow's limit is below the size of today's photos; ours is checked against the size returned here.
Image.MAX_IMAGE_PIXELS = None


def size_in_header(data: bytes) -> tuple[Size, int] | None:
    """Width and height in the header of an image file, and the bytes of memory to decode it.

    None if they cannot be determined.
    """
    measure: Callable[[bytes], tuple[int, int, int]] = _by_pillow
    if data.startswith(PNG_START):
        measure = _of_png
    elif data.startswith(START):
        measure = _of_jpeg
    elif data.startswith(b"BM"):
        measure = _of_bmp
    elif data.startswith(_TIFF_STARTS):
        measure = _of_tiff
    try:
        width, height, pixel_bytes = measure(data)
    except (struct.error, *UNREADABLE):
        return None
    return (Size(width, height), width * height * pixel_bytes) if width > 0 and height > 0 else None


def _of_png(data: bytes) -> tuple[int, int, int]:
    """Its first chunk, without which no decoder reads on."""
    name, width, height, bits, colours = struct.unpack_from(">4sIIBB", data, 12)
    if name != b"IHDR":
        raise ValueError("no header")
    return width, height, _PNG_CHANNELS[colours] * (2 if bits > 8 else 1)


def _of_jpeg(data: bytes) -> tuple[int, int, int]:
    """Where the components are spread over several scans, the decoder holds all coefficients until the last scan."""
    frame, is_progressive = b"", False
    for marker, content in segments(data):
        if marker in FRAMES:
            frame, is_progressive = content, marker in PROGRESSIVE
        elif marker == SCAN:
            height, width, components = struct.unpack_from(">HHB", frame, 1)
            channels = 1 if components == 1 else _COLOUR
            if is_progressive or content[0] < components:
                channels += _coefficient_bytes(frame[7 : 6 + 3 * components : 3])
            return width, height, channels
    raise ValueError("no picture")


def _coefficient_bytes(factors: bytes) -> int:
    """Return the bytes of the 16-bit coefficients for one pixel; `factors`: horizontal and vertical sampling of each
    component.
    """
    sampled = [(factor >> 4) * (factor & 15) for factor in factors]
    return ceil(2 * sum(sampled) / max(sampled))


def _of_bmp(data: bytes) -> tuple[int, int, int]:
    (header_bytes,) = struct.unpack_from("<I", data, 14)
    old = header_bytes == 12  # OS/2 headers have shorter numbers
    width, height, _, bits = struct.unpack_from("<HHHH" if old else "<iiHH", data, 18)
    return abs(width), abs(height), _WITH_ALPHA if bits > 24 else _COLOUR


def _of_tiff(data: bytes) -> tuple[int, int, int]:
    """Size in the first directory; Pillow opens only formats that it can decode."""
    file = BytesIO(data)
    tags: Any = TiffImagePlugin.ImageFileDirectory_v2(file.read(16 if b"+" in data[:4] else 8))
    file.seek(tags.next)
    tags.load(file)
    width, height, samples = int(tags[_WIDTH]), int(tags[_HEIGHT]), int(tags.get(_SAMPLES, 1))
    bits = max(map(int, tags.get(_BITS, (1,))))
    channels = _COLOUR if tags.get(_PHOTOMETRIC) == _PALETTE else samples
    return width, height, max(1, channels) * max(1, -(-bits // 8))


def _by_pillow(data: bytes) -> tuple[int, int, int]:
    with Image.open(BytesIO(data)) as image:
        channels = _MODES.get(image.mode, _COLOUR)
        pixel_bytes = channels * _depth(image, data)
        return image.width, image.height, pixel_bytes + channels * _HELD_BESIDE.get(image.format or "", 0)


def _depth(image: Image.Image, data: bytes) -> int:
    """Bytes per channel, if Pillow's mode does not determine them."""
    tiles = getattr(image, "tile", None)
    layout = str(tiles[0][3]) if tiles else ""
    match image.format:
        case "PPM":
            highest = max(map(int, re.findall(r"\d+", layout)), default=1)
            return 2 if "I;16" in layout or highest > _IN_A_BYTE else 1
        case "JPEG2000":
            return _depth_of_jpeg2000(data)
        case "AVIF":
            return 2  # 10 or 12 bits, maybe
    return 2 if "16" in image.mode else 1


def _depth_of_jpeg2000(data: bytes) -> int:
    """Read the depth from the codestream (ISO/IEC 15444-1, A.5.1), after boxes that each have a length and a name
    (I.4).
    """
    at = 0
    while data[at : at + 4] != _CODESTREAM:
        length, name = struct.unpack_from(">I4s", data, at)
        start = 8
        if length == 1:
            (length,), start = struct.unpack_from(">Q", data, at + 8), 16
        at += start if name == b"jp2c" else max(start, length)
    (count,) = struct.unpack_from(">H", data, at + 40)
    depths = struct.unpack_from(f">{count * 3}B", data, at + 42)[::3]
    return 2 if max(depths) & 0x7F > 7 else 1
