"""A camera's frame for the eye: reduced, its clipped pixels marked, its grey levels counted."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Image
from scanner.decoding import saturation_level
from scanner.rendering import BLUE, reduced_size

# Okabe and Ito's vermilion: told from every grey by every kind of colour vision.
CLIPPED_COLOUR = (213, 94, 0)
DARK_COLOUR = BLUE
HISTOGRAM_BINS = 64
_SHARP_SIDE, _MOST = 1024, 0.5
_LONGEST_SIDE = 720
_DARK_SHARE = 0.02


@dataclass(frozen=True)
class Exposed:
    """The exposure of a frame: `clipped` and `dark` are shares of its pixels; `median` is a share of the full scale."""

    clipped: float
    dark: float
    median: float


def clipped_pixels(image: Image, highest_level: int) -> Bools:
    """Which pixels (H, W) are clipped, in any channel; JPEG-like spreading in 8 bits is allowed for."""
    level = float(highest_level) if image.dtype != np.uint8 else min(saturation_level(image), float(highest_level))
    return np.asarray(_brightest(image) >= level)


def dark_pixels(image: Image, highest_level: int) -> Bools:
    """Which pixels (H, W) are dark in every channel: under 2 % of the camera's highest level."""
    return np.asarray(_brightest(image) < _DARK_SHARE * highest_level)


def sharpness(image: Image) -> float:
    """How much finest detail the middle of a picture has, as a share of its brightness: comparable for one scene only.

    0 for a picture without light.
    """
    bright = _brightest(image)
    top, left = (max(0, (length - _SHARP_SIDE) // 2) for length in bright.shape)
    middle = bright[top : top + _SHARP_SIDE, left : left + _SHARP_SIDE].astype(np.float32)
    mean = float(middle.mean())
    # Smoothed, because noise is as fine.
    detail = cv2.Laplacian(cv2.GaussianBlur(middle, (0, 0), 1.0), cv2.CV_32F)
    return float(np.sqrt(np.mean(detail**2))) / mean if mean > 0 else 0.0


def exposed(image: Image, highest_level: int) -> Exposed:
    """Clipped: at the camera's highest level. Dark: under 2 % of it."""
    bright = _brightest(image)
    return Exposed(
        float(np.mean(clipped_pixels(image, highest_level))),
        float(np.mean(dark_pixels(image, highest_level))),
        float(np.median(bright)) / highest_level,
    )


def histogram(image: Image, highest_level: int) -> tuple[Floats, Floats]:
    """Middles of equal ranges of grey levels, in per cent of all, and how many pixels are in each, (64,) both."""
    counts, edges = np.histogram(_brightest(image), HISTOGRAM_BINS, range=(0, highest_level + 1))
    middles: Floats = 100 * (edges[:-1] + edges[1:]) / 2 / (highest_level + 1)
    return middles, counts.astype(np.float64)


def shown(
    image: Image, highest_level: int, *, mark_clipped: bool, mark_dark: bool = False, longest_side: int = _LONGEST_SIDE
) -> NDArray[np.uint8]:
    """RGB, reduced to a `longest_side`, brightness as the camera has it; clipped pixels in `CLIPPED_COLOUR` if wanted,
    dark ones in `DARK_COLOUR`.

    A mark is as large as a pixel of the reduced picture at least, so that no clipped pixel is lost in it. Dark is what
    most pixels there are.
    """
    size = reduced_size(image.shape[1], image.shape[0], longest_side)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32) * np.float32(255 / highest_level)
    grey = np.rint(np.minimum(small, np.float32(255))).astype(np.uint8)
    rgb = np.asarray(cv2.cvtColor(grey, cv2.COLOR_BGR2RGB if grey.ndim == 3 else cv2.COLOR_GRAY2RGB), np.uint8)
    if mark_dark:
        dark = dark_pixels(image, highest_level).astype(np.float32)
        rgb[np.asarray(cv2.resize(dark, size, interpolation=cv2.INTER_AREA)) > _MOST] = DARK_COLOUR
    if mark_clipped:
        clipped = clipped_pixels(image, highest_level).astype(np.float32)
        rgb[np.asarray(cv2.resize(clipped, size, interpolation=cv2.INTER_AREA)) > 0] = CLIPPED_COLOUR
    return rgb


def _brightest(image: Image) -> Image:
    return image if image.ndim == 2 else image.max(axis=2)
