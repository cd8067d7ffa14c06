"""Photo files: upright pixels, and the focal length of their EXIF data."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import ExifTags, Image

from calib.geometry import Size
from calib.numerics import Image as Pixels
from scanner.errors import InputError
from scanner.io import UNREADABLE, read_image, real_path

_FULL_FRAME_DIAGONAL_MM = 43.2666  # of 36 × 24 mm, to which the 35 mm equivalent refers (CIPA DCG-001)
_LONGEST_MM = 10_000
# A result takes about 130 bytes per pixel. Lenses resolve no more, and larger sensors mostly bin their pixels.
_MOST_PX = 65_000_000
_UPRIGHT = 1
# EXIF orientation → transform that turns the stored array upright.
_TURNS = {
    2: lambda pixels: pixels[:, ::-1],
    3: lambda pixels: pixels[::-1, ::-1],
    4: lambda pixels: pixels[::-1],
    5: lambda pixels: pixels.swapaxes(0, 1),
    6: lambda pixels: np.rot90(pixels, -1),
    7: lambda pixels: pixels[::-1, ::-1].swapaxes(0, 1),
    8: lambda pixels: np.rot90(pixels),
}


@dataclass(frozen=True)
class Photo:
    """A photo: `pixels` (H, W) or (H, W, 3) BGR in upright orientation; `focal_px` by its EXIF data, or None.

    `reduced`: pixels of the file per pixel, along each side.
    """

    path: Path
    pixels: Pixels
    focal_px: float | None
    reduced: int = 1

    @property
    def size(self) -> Size:
        """The size of the upright photo."""
        return Size.of(self.pixels)


@dataclass(frozen=True)
class _Stored:
    path: Path
    pixels: Pixels
    orientation: int
    focal_mm: float | None
    reduced: int

    def turned(self, orientation: int) -> Photo:
        turn = _TURNS.get(orientation)
        pixels = np.ascontiguousarray(turn(self.pixels)) if turn else self.pixels
        diagonal_px = float(np.hypot(*pixels.shape[:2]))
        focal = None if self.focal_mm is None else self.focal_mm * diagonal_px / _FULL_FRAME_DIAGONAL_MM
        return Photo(self.path, pixels, focal, self.reduced)


def read_photos(paths: Sequence[Path]) -> list[Photo]:
    """Photos of one camera and size, in the orientation of their EXIF data.

    A camera held upright for one photo and sideways for another has one sensor. If only the sizes in the files agree,
    all photos are rotated like the first, so that one principal point holds for all. Photos of more than 65 megapixels
    are reduced by a whole factor.

    Raises InputError for a file that cannot be read, one given twice, or photos of different sizes.
    """
    for i, path in enumerate(paths):
        if any(real_path(path) == real_path(earlier) for earlier in paths[:i]):
            raise InputError(f"{path}: was given twice; photos from different places are needed")
    stored = [_read(path) for path in paths]
    upright = [photo.turned(photo.orientation) for photo in stored]
    if len({photo.size for photo in upright}) == 1:
        return upright
    if len({photo.pixels.shape[:2] for photo in stored}) == 1:
        return [photo.turned(stored[0].orientation) for photo in stored]
    sizes = ", ".join(f"{photo.path.name} {photo.size}" for photo in upright)
    raise InputError(
        f"the photos must be of one size, found {sizes}: take them with one camera at one zoom, and crop all or none "
        "of them, in the same way"
    )


def _read(path: Path) -> _Stored:
    pixels = read_image(path)
    if pixels.dtype != np.uint8:
        pixels = (pixels >> 8).astype(np.uint8)
    reduced = math.ceil(math.sqrt(pixels.shape[0] * pixels.shape[1] / _MOST_PX))
    orientation, focal_mm = _exif(path)
    return _Stored(path, _binned(pixels, reduced), orientation, focal_mm, reduced)


def _binned(pixels: Pixels, count: int) -> Pixels:
    """The means of `count` × `count` 8-bit pixels; a rim that does not fill one is left out."""
    if count == 1:
        return pixels
    height, width = (length // count for length in pixels.shape[:2])
    whole = pixels[: height * count, : width * count]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _exif(path: Path) -> tuple[int, float | None]:
    """Orientation, and the focal length equivalent to 35 mm film; missing values are left out."""
    try:
        with Image.open(path) as image:
            exif, is_tiff = image.getexif(), image.format == "TIFF"
            focal = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
            stated = exif.get(ExifTags.Base.Orientation, _UPRIGHT)
    except UNREADABLE:
        return _UPRIGHT, None  # OpenCV reads formats and damaged EXIF data that Pillow cannot
    # OpenCV rotates TIFF files itself, and no other format if read unchanged.
    orientation = stated if isinstance(stated, int) and stated in _TURNS and not is_tiff else _UPRIGHT
    focal_mm = float(focal) if isinstance(focal, int | float) and 0 < focal < _LONGEST_MM else None  # 0 is unknown
    return orientation, focal_mm
