"""JPEG files: their markers (ITU-T T.81, table B.1), whether one was cut off, and the size in its header."""

START, START_OF_SCAN, END_OF_IMAGE = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # starts of frames
_FILL = 0xFF


def is_whole_jpeg(content: bytes) -> bool:
    """Whether a JPEG file ends as one, and was not cut off."""
    # The last scan is followed by the end of the image; a preview before it has its own of both (ITU-T T.81, annex B).
    return content.startswith(START) and content.rfind(START_OF_SCAN) < content.rfind(END_OF_IMAGE)


def jpeg_size(content: bytes) -> tuple[int, int] | None:
    """(width, height) in the header of a JPEG file, None if it has none, or if anything else is in between."""
    at = len(START)
    while at + 9 <= len(content) and content[at] == _FILL:
        marker = content[at + 1]
        if marker in FRAMES:
            return int.from_bytes(content[at + 7 : at + 9], "big"), int.from_bytes(content[at + 5 : at + 7], "big")
        at += 1 if marker == _FILL else 2 + int.from_bytes(content[at + 2 : at + 4], "big")
    return None
