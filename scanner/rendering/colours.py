"""Colours that are distinguishable with every kind of colour vision, tables of shades, and PNG files of such pictures.

A palette makes the file of a map a quarter of the work.
"""

from dataclasses import dataclass
from io import BytesIO

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from calib.numerics import Floats

Pixels = NDArray[np.uint8]

# Higher levels take several times as long to save a few per cent.
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


def png_of(picture: IndexedPicture | Pixels) -> bytes:
    """The file of a picture with a palette, or of RGBA (H, W, 4)."""
    if isinstance(picture, IndexedPicture):
        image = Image.fromarray(picture.index)
        image.putpalette(picture.palette[:, :3].tobytes(), "RGB")
        opacity = picture.palette[:, 3].tobytes()
    else:
        image, opacity = Image.fromarray(picture), None
    file = BytesIO()
    image.save(file, "PNG", compress_level=_LEVEL, **({} if opacity is None else {"transparency": opacity}))
    return file.getvalue()


# Okabe & Ito (2008): distinguishable with any colour vision, and in print.
ORANGE, SKY_BLUE, GREEN, YELLOW = (230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66)
BLUE, VERMILION, PURPLE, GREY = (0, 114, 178), (213, 94, 0), (204, 121, 167), (140, 140, 140)
BLACK = (0, 0, 0)
FACE_COLOURS = (ORANGE, SKY_BLUE, GREEN)
BROWN = (112, 66, 20)
Colour = tuple[int, int, int]


@dataclass(frozen=True)
class ColourScale:
    """A continuous legend: CSS colours from the low to the high end, and labels of the ends."""

    colours: tuple[str, ...]
    low: str
    high: str


def part_of(colour_map: int, first: int, last: int) -> Pixels:
    """A part of one of OpenCV's colour maps, RGB (n, 3)."""
    shades = cv2.applyColorMap(np.arange(first, last + 1, dtype=np.uint8)[:, None], colour_map)
    return np.ascontiguousarray(shades[:, 0, ::-1])


def between(low: Colour, middle: Colour, high: Colour) -> Pixels:
    """Shades from one colour to another through a third, RGB (n, 3)."""
    places = np.linspace(0, 2, 255)
    return as_pixels(np.stack([np.interp(places, (0, 1, 2), ends) for ends in zip(low, middle, high, strict=True)], 1))


def as_pixels(values: Floats) -> Pixels:
    """Rounded to bytes."""
    return np.ascontiguousarray(np.rint(values), dtype=np.uint8)


# All of them stand out on white and black pages, with any colour vision.
# Complete tables, dark to bright; their order of shades is visible with any colour vision.
VIRIDIS, CIVIDIS = part_of(cv2.COLORMAP_VIRIDIS, 0, 255), part_of(cv2.COLORMAP_CIVIDIS, 0, 255)
# Around zero: blue below, light grey, red above.
SIGNED = between((0, 84, 166), (226, 226, 226), (186, 62, 0))


def css_colour(colour: Colour) -> str:
    """#rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def shaded(share: NDArray[np.floating], shades: Pixels) -> Pixels:
    """RGB (..., 3) of shares from 0 to 1 (...), by a table of shades."""
    count = len(shades)
    return np.asarray(shades[np.minimum(share * count, count - 1).astype(np.intp)], np.uint8)
