"""Segments of a JPEG file (ITU-T T.81, annex B) in order, without the compressed data between them."""

import re
from collections.abc import Iterator

SCAN, END = 0xDA, 0xD9
FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
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
