"""Image files: whatever OpenCV reads, as it is in the file."""

from pathlib import Path

import cv2
import numpy as np

from calib.numerics import Image
from scanner.errors import InputError

_COMMON = {".png", ".jpg", ".jpeg", ".jpe", ".tif", ".tiff", ".bmp", ".dib", ".webp", ".gif", ".jp2"}
_RARE = {".pgm", ".ppm", ".pnm", ".pbm", ".ras", ".sr", ".exr", ".hdr", ".avif"}
SUFFIXES = frozenset(_COMMON | _RARE)


def read_image(path: Path) -> Image:
    """An image file as (H, W) grey or (H, W, 3) BGR, 8 or 16 bit; transparency is dropped, EXIF rotation ignored.

    Raises InputError if the file is missing, truncated, no image, or of another type.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if not data:
        raise InputError(f"{path}: the file is empty")
    if _is_truncated(data):
        raise InputError(f"{path}: the image is truncated: its end is missing; copy the file again")
    # imdecode, because imread fills what is missing of a JPEG with grey and returns it.
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(f"{path}: cannot be decoded as an image: {error.err}") from error
    if image is None:
        raise InputError(f"{path}: cannot be decoded as an image: damaged, truncated, or of an unknown format")
    colours = np.ascontiguousarray(image[:, :, :3]) if image.ndim == 3 else image
    if colours.dtype == np.uint8:
        return colours.astype(np.uint8, copy=False)
    if colours.dtype == np.uint16:
        return colours.astype(np.uint16, copy=False)
    raise InputError(f"{path}: expected 8 or 16 bit whole numbers per channel, found {image.dtype}")


def _is_truncated(data: bytes) -> bool:
    if data.startswith(b"\x89PNG"):
        return data.find(b"IEND", data.rfind(b"IDAT")) < 0
    if data.startswith(b"\xff\xd8"):
        # After the last start of scan: an end marker before it may be that of an embedded thumbnail.
        return data.find(b"\xff\xd9", data.rfind(b"\xff\xda")) < 0
    return False


def write_png(path: Path, image: Image) -> None:
    """Write a PNG, lightly compressed: a camera should not have to wait for it. Raises OSError."""
    encoded, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not encoded:
        raise ValueError(f"an image of shape {image.shape} and type {image.dtype} cannot be written as PNG")
    path.write_bytes(data.tobytes())
