"""A grid of pixels of every frame: enough to see what the frames are."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from calib.numerics import Bools, Floats, Image
from scanner.errors import InputError
from scanner.importing.layout import Size
from scanner.io import read_image

_ACROSS = 160
# Of the brightness range of well lit pixels: less is not lit.
_LIT = 0.2


@dataclass(frozen=True)
class Samples:
    """Grey levels (frames, H, W) at a grid of pixels, `camera_px` (H, W, 2); `camera_size` is (width, height)."""

    levels: Floats
    camera_px: Floats
    camera_size: Size

    @cached_property
    def swing(self) -> Floats:
        """(H, W): from the darkest frame to the brightest."""
        swing: Floats = np.ptp(self.levels, axis=0)
        return swing

    @cached_property
    def lit(self) -> Bools:
        """(H, W): pixels that the frames light differently."""
        lit: Bools = self.swing > max(_LIT * float(np.percentile(self.swing, 98)), 1.0)
        return lit


def take_samples(files: Sequence[Path]) -> Samples:
    """Read all frames. Raises InputError if one is no image, or of another size or kind than the first."""
    levels, first = [], None
    for path in files:
        image = read_image(path)
        if first is not None and (image.shape, image.dtype) != (first.shape, first.dtype):
            raise InputError(
                f"{path}: expected an image of the kind of {files[0].name}, {_kind(first)}, found {_kind(image)}"
            )
        first = image if first is None else first
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        step = max(1, image.shape[1] // _ACROSS)
        levels.append(grey[step // 2 :: step, step // 2 :: step].astype(np.float64))
    if first is None:
        raise InputError("no frames")
    height, width = levels[0].shape
    row, column = np.mgrid[:height, :width]
    camera_px = np.stack([column, row], axis=-1) * float(step) + step // 2
    return Samples(np.stack(levels), camera_px, (first.shape[1], first.shape[0]))


def _kind(image: Image) -> str:
    colours = "colour" if image.ndim == 3 else "grey"
    return f"{image.shape[1]} × {image.shape[0]}, {8 * image.itemsize}-bit {colours}"
