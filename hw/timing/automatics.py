"""Detects automatic changes of exposure, white balance and focus, by one picture before and after a capture."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Image, grey

_SAME_VIEW = 0.3  # correlation, which blur and dimming hardly change
_CELLS = 32  # across the picture: its edges are resolved, and show blur


@dataclass(frozen=True)
class Appearance:
    """The reference picture as the camera sees it: mean level of each channel (C,) of lit pixels, contrast of its
    edges, and brightness (N,) of the lit pixels.
    """

    levels: np.ndarray
    contrast: float
    lit: Floats


def reference_picture(size: tuple[int, int]) -> Image:
    """A checkerboard of (width, height)."""
    width, height = size
    cell = max(2, width // _CELLS)
    odd = (np.arange(height)[:, None] // cell + np.arange(width)[None, :] // cell) % 2
    return np.where(odd, np.uint8(255), np.uint8(0))


def appearance(image: Image, lit: Bools) -> Appearance:
    """The appearance of a frame (H, W) or (H, W, C); `lit` (H, W)."""
    levels = image[lit].reshape(int(lit.sum()), -1).mean(axis=0, dtype=np.float64)
    light = grey(image)
    both = lit[:, 1:] & lit[:, :-1]
    contrast = float(np.sqrt(np.mean((np.diff(light, axis=1)[both]) ** 2))) if both.any() else 0.0
    return Appearance(levels, contrast / max(float(levels.mean()), 1.0), light[lit])


def is_another_view(first: Appearance, now: Appearance) -> bool:
    """Whether the camera was moved or turned, or sends frames of another shape."""
    return not float(np.corrcoef(first.lit, now.lit)[0, 1]) > _SAME_VIEW


def changes(first: Appearance, last: Appearance) -> Mapping[str, float]:
    """Changes of exposure, white balance and focus in per cent, for the recording's metadata."""
    ratio = last.levels / np.maximum(first.levels, 1.0)
    balance = float(np.ptp(ratio) / ratio.mean())
    return {
        "exposure_percent": round(100 * (float(ratio.mean()) - 1), 1),
        "white_balance_percent": round(100 * balance, 1),
        "focus_percent": round(100 * (last.contrast / max(first.contrast, 1e-9) - 1), 1),
    }
