"""Check that an image file is complete and undamaged, as far as its format allows.

OpenCV decodes, and accepts much that is damaged. Pillow is a second opinion on TIFF, where it detects damage in
compressed pixels. In a format without checksums, a flipped bit is a wrong pixel, which cannot be detected.
"""

import zlib
from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import Any

from PIL import Image, UnidentifiedImageError

from hw.jpeg import START, is_whole_jpeg
from scanner.io.given_file import MOST_IMAGE_BYTES
from scanner.io.image_size import PNG_START, SCAN, UNREADABLE, segments
from scanner.io.jpeg_check import problem_of_jpeg

_WITHOUT_CHECK = {"TIFF"}  # formats that OpenCV reads despite damage, which is reported here
_COMPRESSION, _DEFLATE = 259, (8, 32946)
_PARTS = ((273, 279), (324, 325))  # offsets and lengths, of strips and of tiles
_AT_ONCE_BYTES = 1_000_000
_MOST_SCANS = 100  # scans of a JPEG, each of which visits all pixels; encoders write at most 14
_NOT_DAMAGE = ("not available", "unknown", "unsupported", "not supported")


def damage(data: bytes) -> str | None:
    """Return the damage of an image file, even one that OpenCV accepts; None if none is known."""
    if data.startswith(PNG_START):
        return _damage_of_png(data)
    if data.startswith(START):
        if not is_whole_jpeg(data):
            return "truncated, its end is missing"
        scans = sum(marker == SCAN for marker, _ in segments(data))
        return problem_of_jpeg(data) if scans <= _MOST_SCANS else f"its pixels are written {scans:,} times over"
    try:
        with Image.open(BytesIO(data)) as image:
            if image.format not in _WITHOUT_CHECK:
                return None
            return _damage_of_tiff(image, data)
    except (UnidentifiedImageError, *UNREADABLE):
        return None


def _damage_of_png(data: bytes) -> str | None:
    """Whether its chunks (length, name, content, check sum) reach to the last; OpenCV makes room for any length."""
    at = len(PNG_START)
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
    remaining = MOST_IMAGE_BYTES  # for all strips together, which may share one place
    for offsets, lengths in _PARTS:
        for offset, length in zip(tags.get(offsets, ()), tags.get(lengths, ()), strict=False):
            unpacking = zlib.decompressobj()
            try:
                for unpacked in _unpacked(unpacking, memoryview(data)[offset : offset + length]):
                    remaining -= unpacked
                    if remaining < 0:
                        return "its parts unpack to more than an image has"
            except zlib.error as error:
                return f"its pixels do not decode ({error})"
            if not unpacking.eof:
                return "truncated, the end of its pixels is missing"
    return None


def _unpacked(unpacking: Any, part: memoryview) -> Iterator[int]:
    """Count the decompressed bytes in small pieces, keeping none."""
    for start in range(0, len(part), _AT_ONCE_BYTES):
        packed: Any = part[start : start + _AT_ONCE_BYTES]
        while packed and not unpacking.eof:
            yield len(unpacking.decompress(packed, _AT_ONCE_BYTES))
            packed = unpacking.unconsumed_tail
    yield len(unpacking.flush())
