"""A plane rectified from a station's picture: its texture looks the same from every station."""

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Image

_DARKEST = 0.02  # share of the brightest level; logarithms of less are noise
_BORDER_PX = 5


def logarithmic(picture: Image) -> NDArray[np.uint8]:
    """Of a picture (H, W) or (H, W, 3), from 0 to 255: steps of it are albedos', however much light falls on them."""
    grey = picture.mean(axis=2) if picture.ndim == 3 else picture
    bright = max(float(np.percentile(grey, 99.5)), 1.0)
    light = np.log(np.clip(grey / bright, 0.0, 1.0) + _DARKEST)
    low, high = np.log(_DARKEST), np.log(1 + _DARKEST)
    levels: NDArray[np.uint8] = np.rint(255 * (light - low) / (high - low)).astype(np.uint8)
    return levels


def drawn(
    light: NDArray[np.uint8], on_plane: NDArray[np.bool_], pixels: Floats
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The drawing (h, w) of camera `pixels` (h, w, 2), NaN for none; and its mask, 255 slightly inside the border of
    `on_plane` (H, W).
    """
    at = np.where(np.isfinite(pixels), pixels, -1e4).astype(np.float32)
    column, row = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
    drawing = cv2.remap(light, column, row, cv2.INTER_LINEAR)
    visible = cv2.remap(on_plane.astype(np.uint8), column, row, cv2.INTER_NEAREST)
    visible = cv2.morphologyEx(visible, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    inside = cv2.erode(visible, np.ones((2 * _BORDER_PX + 1,) * 2, np.uint8), borderValue=0)
    return drawing.astype(np.uint8), (255 * inside).astype(np.uint8)
