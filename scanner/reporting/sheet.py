"""The pictures of the first printed page: small versions of those of the page."""

import cv2
import numpy as np

from scanner.rendering import Pixels

_SIDE = 640


def on_paper(pixels: Pixels) -> Pixels:
    """RGB (H, W, 3), or RGBA on white, reduced, as it is on the page a second time: RGB (h, w, 3)."""
    if pixels.shape[2] == 4:
        share = pixels[..., 3:].astype(np.float32) / 255
        pixels = np.rint(share * pixels[..., :3] + 255 * (1 - share)).astype(np.uint8)
    factor = min(1.0, _SIDE / max(pixels.shape[:2]))
    return np.asarray(cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8)
