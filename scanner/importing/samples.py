"""Sample some rows and columns of every frame: enough to recognise the patterns."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from calib.numerics import Bools, Floats, Image, Ints
from scanner.errors import InputError
from scanner.importing.frame_files import read_frame
from scanner.importing.layout import Size
from scanner.patterns import Axis

_ACROSS = 160
# Share of the swing of well lit pixels (a percentile) below which a pixel is unlit.
_LIT, _WELL_LIT = 0.2, 99.0
_SEED = 1
_LINES = 96


@dataclass(frozen=True, eq=False)  # a key by identity, of what is computed from it
class LevelSamples:
    """Grey levels (frames, H, W) where some rows and columns cross, at `camera_px` (H, W, 2).

    `camera_size` is (width, height).
    """

    levels: Floats
    camera_px: Floats
    camera_size: Size

    @cached_property
    def swing(self) -> Floats:
        """(H, W): from the darkest frame to the brightest."""
        swing: Floats = np.ptp(self.levels, axis=0)
        return swing

    @cached_property
    def copies(self) -> frozenset[int]:
        """The frames that are the one before, exactly: of a projector that was late, or given twice by the camera."""
        same = np.all(self.levels[1:] == self.levels[:-1], axis=(1, 2))
        return frozenset((np.flatnonzero(same) + 1).tolist())

    @cached_property
    def lit(self) -> Bools:
        """(H, W): pixels that the frames light differently."""
        return self.swing > max(_LIT * float(np.percentile(self.swing, _WELL_LIT)), 1.0)


def take_samples(files: Sequence[Path], flip: Axis | None = None) -> LevelSamples:
    """Read all frames, mirrored back along an axis.

    Raises InputError if one is no image, or of another size or kind than the first.
    """
    first = read_frame(files[0], flip)
    height, width = first.shape[:2]
    # Random, because a grid would beat with the stripes.
    rng = np.random.default_rng(_SEED)
    step = max(1, width // _ACROSS)
    rows, columns = (
        np.arange(0, size - step + 1, step) + rng.integers(0, step, (size - step) // step + 1)
        for size in (height, width)
    )
    return _sampled(files, flip, first, rows, columns)


def take_lines(files: Sequence[Path], axis: Axis, flip: Axis | None) -> LevelSamples:
    """Some rows of every frame with all of their pixels, or some columns: along which the coordinate of an axis grows.

    Mirrored back as in `take_samples`, which also says what it raises.
    """
    first = read_frame(files[0], flip)
    height, width = first.shape[:2]
    across = np.linspace(0, (height if axis == "x" else width) - 1, _LINES + 2).astype(np.int64)[1:-1]
    rows, columns = (across, np.arange(width)) if axis == "x" else (np.arange(height), across)
    return _sampled(files, flip, first, rows, columns)


def _sampled(files: Sequence[Path], flip: Axis | None, first: Image, rows: Ints, columns: Ints) -> LevelSamples:
    height, width = first.shape[:2]
    levels = []
    for path in files:
        image = read_frame(path, flip)
        if (image.shape, image.dtype) != (first.shape, first.dtype):
            raise InputError(
                f"{path}: expected an image of the kind of {files[0].name}, {_kind(first)}, found {_kind(image)}"
            )
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        levels.append(grey[np.ix_(rows, columns)].astype(np.float64))
    camera_px = np.stack(np.meshgrid(columns, rows), axis=-1).astype(np.float64)
    return LevelSamples(np.stack(levels), camera_px, (width, height))


def _kind(image: Image) -> str:
    colours = "colour" if image.ndim == 3 else "grey"
    return f"{image.shape[1]} × {image.shape[0]}, {8 * image.itemsize}-bit {colours}"
