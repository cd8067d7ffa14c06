"""A sparse sample of every frame, from which noise, tolerances and frame checks are computed."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Image
from scanner.decoding.arrays import Floats32
from scanner.decoding.light.mosaic import BAYER_PX
from scanner.decoding.subsampling import at_random

_MOST_PIXELS = 16384  # so that a hundred are left in 1 % of the picture


class Sample:
    """Grey levels of some pixels in all frames. `pixels` (P,) are flat indices into the image.

    The pixels are random, because a regular grid could beat with the fringes. With `neighbours` each pixel comes with
    one on its left and one on its right.
    """

    def __init__(self, shape: tuple[int, int], *, neighbours: bool) -> None:
        height, width = shape
        margin = BAYER_PX if neighbours and width > 2 * BAYER_PX else 0
        inner = width - 2 * margin
        row, column = np.divmod(at_random(height * inner, _MOST_PIXELS), inner)
        self.pixels: NDArray[np.int64] = row * width + column + margin
        self._margin = margin
        self._frames: list[NDArray[Any]] = []
        self._left: list[NDArray[Any]] = []
        self._right: list[NDArray[Any]] = []

    def add(self, grey: Image) -> None:
        """Sample one frame (H, W)."""
        flat = grey.reshape(-1)
        places = [(self._frames, self.pixels)]
        if self._margin:
            places += [(self._left, self.pixels - BAYER_PX), (self._right, self.pixels + BAYER_PX)]
        for levels, pixels in places:
            levels.append(flat.take(pixels, mode="clip"))  # all are inside; clip mode skips the bounds check

    def has(self, *frames: int) -> bool:
        """Whether these frames have been added."""
        return max(frames) < len(self._frames)

    def level(self, frame: int) -> NDArray[Any]:
        """Return the grey levels (P,) of a frame that has been added."""
        return self._frames[frame]

    def divide(self, frame: int, by: Floats) -> None:
        """Divide the levels of a frame by `by`, (P,) or (1,), including its neighbours."""
        for levels in (self._frames, self._left, self._right)[: 3 if self._margin else 1]:
            levels[frame] = (levels[frame] / by).astype(np.float32)

    def leave_out(self, chosen: Bools) -> None:
        """Remove the chosen pixels (P,), once all frames are in."""
        self.pixels = self.pixels[~chosen]
        for levels in (self._frames, self._left, self._right):
            levels[:] = [of_frame[~chosen] for of_frame in levels]

    @property
    def as_taken(self) -> Image:
        """(frames, P): grey levels as the camera gave them, once all frames are in and before any is divided."""
        return np.stack(self._frames)

    @property
    def levels(self) -> Floats32:
        """(frames, P): grey levels, once all frames are in."""
        return np.stack(self._frames, dtype=np.float32)

    @property
    def curvature(self) -> Floats32 | None:
        """(frames, P): left − 2 · centre + right, or None without neighbours."""
        if not self._margin:
            return None
        left, right = np.stack(self._left).astype(np.float32), np.stack(self._right).astype(np.float32)
        return left - 2 * self.levels + right
