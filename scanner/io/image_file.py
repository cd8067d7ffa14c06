"""Image files in all formats of OpenCV, unchanged."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Size
from calib.numerics import Image
from scanner.errors import InputError
from scanner.io.given_file import MOST_IMAGE_BYTES, MOST_IMAGE_FILE_BYTES, megabytes, read_bytes
from scanner.io.image_damage import damage
from scanner.io.image_size import size_in_header
from scanner.shown_text import shown

_COMMON = {".png", ".jpg", ".jpeg", ".jpe", ".tif", ".tiff", ".bmp", ".dib", ".webp", ".gif", ".jp2"}
_RARE = {".pgm", ".ppm", ".pnm", ".pbm", ".ras", ".sr", ".exr", ".hdr", ".avif"}
_COLOUR = 3  # channels
_DEEPEST = 6  # bytes of a pixel in 16-bit colour
_FEW_BYTES = 100_000_000
_NO_IMAGE = "cannot be decoded as an image: damaged, truncated, or of an unknown format"
SUFFIXES = frozenset(_COMMON | _RARE)


def read_image(path: Path, expected: Size | None = None) -> Image:
    """An image file as (H, W) grey or (H, W, 3) BGR, 8 or 16 bit; transparency is dropped, EXIF rotation ignored.

    Raises InputError if the file is missing, no regular file, truncated, no image, of another type, or would take more
    than `MOST_IMAGE_BYTES` of memory, or far more than an image of the `expected` size, which is not checked otherwise.
    """
    data = read_bytes(path, MOST_IMAGE_FILE_BYTES)
    if not data:
        raise InputError(f"{path}: the file is empty")
    most = MOST_IMAGE_BYTES if expected is None else max(_FEW_BYTES, _DEEPEST * expected.width * expected.height)
    _refuse_large(path, data, min(most, MOST_IMAGE_BYTES))
    if cause := damage(data):
        raise InputError(f"{path}: the image is damaged: {cause}; copy the file again")
    # imdecode, because imread fills missing parts of a JPEG with grey.
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(f"{path}: cannot be decoded as an image: {shown(error.err)}") from error
    if image is None:
        raise InputError(f"{path}: {_NO_IMAGE}")
    colours = _without_alpha(image) if image.ndim == 3 else image
    if colours.dtype == np.uint8:
        return colours.astype(np.uint8, copy=False)
    if colours.dtype == np.uint16:
        return colours.astype(np.uint16, copy=False)
    raise InputError(f"{path}: expected 8 or 16 bit whole numbers per channel, found {image.dtype}")


def _without_alpha(image: NDArray[Any]) -> NDArray[Any]:
    """The first three channels of an image (H, W, C), compacted in place, because a copy could be large."""
    height, width, channels = image.shape
    if channels == _COLOUR:
        return image
    together: NDArray[Any] = image.reshape(-1)[: height * width * _COLOUR].reshape(height, width, _COLOUR)
    for row in range(height):
        together[row] = image[row, :, :_COLOUR].copy()
    return together


def _refuse_large(path: Path, data: bytes, most: int) -> None:
    """Raise InputError for more pixels than the limit, or if their number cannot be determined."""
    size = size_in_header(data)
    if size is None:
        raise InputError(f"{path}: {_NO_IMAGE}")
    if size[1] > most:
        raise InputError(
            f"{path}: has {size[0]} pixels, which would take {megabytes(size[1])} of memory; "
            f"expected no more than {megabytes(most)}"
        )
