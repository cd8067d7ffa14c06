"""What an image file says of itself, read before anything is decoded; and whether all of it is there.

OpenCV decodes, and accepts much that is damaged. Pillow reads the header, and is a second opinion on TIFF, whose damage
it tells where the pixels are compressed. A bit that was flipped in a format without check sums is a wrong pixel, which
nothing in the file tells.
"""

import zlib
from collections.abc import Mapping
from io import BytesIO
from typing import Any

from PIL import Image, UnidentifiedImageError

from calib.geometry import Size
from scanner.io.given_file import MOST_IMAGE_BYTES
from scanner.io.jpeg_check import problem_of_jpeg

# Of what Pillow cannot read at all OpenCV may make something.
UNREADABLE = (OSError, SyntaxError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RuntimeError)
_CHANNELS = {"1": 1, "L": 1, "I": 1, "F": 1, "I;16": 1, "I;16B": 1, "I;16L": 1, "LA": 4, "RGBA": 4, "PA": 4, "CMYK": 4}
_PNG = b"\x89PNG\r\n\x1a\n"
_COLOUR = 3  # also of palettes, which OpenCV resolves
_WITHOUT_CHECK = {"TIFF"}  # of what OpenCV lets pass, these tell their damage
_COMPRESSION, _DEFLATE = 259, (8, 32946)
_PARTS = ((273, 279), (324, 325))  # offsets and lengths, of strips and of tiles
_NOT_DAMAGE = ("not available", "unknown", "unsupported", "not supported")

# Pillow's own limit is lower than today's photos have pixels; `size_in_header` is what is held against ours.
Image.MAX_IMAGE_PIXELS = None


def size_in_header(data: bytes) -> tuple[Size, int] | None:
    """Width and height that an image file promises, and the bytes that its pixels take; None if Pillow cannot tell."""
    try:
        with Image.open(BytesIO(data)) as image:
            tiles = getattr(image, "tile", None)
            layout = str(tiles[0][3]) if tiles else ""
            depth = 2 if "16" in image.mode + layout or (image.format == "PPM" and "65535" in layout) else 1
            return Size(*image.size), image.width * image.height * _CHANNELS.get(image.mode, _COLOUR) * depth
    except UNREADABLE:
        return None


def damage(data: bytes) -> str | None:
    """What is wrong with an image file that OpenCV may accept all the same; None if nothing is known to be."""
    if data.startswith(_PNG):
        return _damage_of_png(data)
    if data.startswith(b"\xff\xd8"):
        # After the last start of scan: an end marker before it may be that of an embedded thumbnail.
        has_end = data.find(b"\xff\xd9", data.rfind(b"\xff\xda")) >= 0
        return problem_of_jpeg(data) if has_end else "truncated, its end is missing"
    try:
        with Image.open(BytesIO(data)) as image:
            if image.format not in _WITHOUT_CHECK:
                return None
            return _damage_of_tiff(image, data)
    except (UnidentifiedImageError, *UNREADABLE):
        return None


def _damage_of_png(data: bytes) -> str | None:
    """Whether its chunks (length, name, content, check sum) reach to the last; OpenCV makes room for any length."""
    at = len(_PNG)
    while at + 12 <= len(data):
        length, name = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        at += 12 + length
        if name == b"IEND" and at <= len(data):
            return None
    return "truncated, its end is missing"


def _damage_of_tiff(image: Image.Image, data: bytes) -> str | None:
    tags = getattr(image, "tag_v2", {})
    if tags.get(_COMPRESSION) in _DEFLATE:
        return _damage_of_deflated(tags, data)
    try:
        image.load()
    except OSError as error:
        return None if any(words in str(error) for words in _NOT_DAMAGE) else f"its pixels do not decode ({error})"
    return None


def _damage_of_deflated(tags: Mapping[int, Any], data: bytes) -> str | None:
    """Strips or tiles end in a check sum, which neither library asks for once it has all pixels."""
    for offsets, lengths in _PARTS:
        for offset, length in zip(tags.get(offsets, ()), tags.get(lengths, ()), strict=False):
            try:
                unpacking = zlib.decompressobj()
                unpacking.decompress(data[offset : offset + length], MOST_IMAGE_BYTES)
            except zlib.error as error:
                return f"its pixels do not decode ({error})"
            if not unpacking.eof:
                return "truncated, the end of its pixels is missing"
    return None
