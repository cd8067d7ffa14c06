"""All frames at a fraction of the camera's pixels, on a regular grid: where something moved, and how large it is."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Image, Ints
from scanner.decoding.arrays import Floats32

# Along the longer side of the image; what is smaller than some of these pixels leaves few matches.
_MOST_ALONG = 224


@dataclass
class CoarseFrames:
    """Every so many-th pixel, along rows and columns, of each frame of `shape` (H, W); grid pixels are (h, w).

    `are_divided`: whether some frames were made darker.
    """

    shape: tuple[int, int]
    are_divided: bool = False
    _frames: list[Image] = field(default_factory=list)

    @cached_property
    def step(self) -> int:
        """From one pixel of the grid to the next."""
        return max(1, -(-max(self.shape) // _MOST_ALONG))

    def of(self, image: NDArray[np.generic]) -> NDArray[np.generic]:
        """The grid's pixels of an image (H, W), (h, w)."""
        half = self.step // 2
        return np.ascontiguousarray(image[half :: self.step, half :: self.step])

    def add(self, grey: Image) -> None:
        """Take the next frame (H, W)."""
        self._frames.append(cast(Image, self.of(grey)))

    def divide(self, frame: int, by_row: Floats) -> None:
        """Make a frame darker by so many times, (h,) or (1,)."""
        self.are_divided = True
        self._frames[frame] = cast(Image, (self._frames[frame] / by_row[:, None]).astype(np.float32))

    @property
    def rows(self) -> Ints:
        """(h,): the rows of the image that those of the grid are."""
        return np.arange(self.shape[0])[self.step // 2 :: self.step]

    @property
    def levels(self) -> Floats32:
        """(frames, h, w) grey levels."""
        return np.stack(self._frames, dtype=np.float32)

    def at_full_size(self, chosen: Bools) -> Bools:
        """The pixels of the image (H, W) that are nearest to those chosen of the grid (h, w)."""
        repeated = cv2.resize(
            chosen.astype(np.uint8),
            (chosen.shape[1] * self.step, chosen.shape[0] * self.step),
            interpolation=cv2.INTER_NEAREST,
        )
        height, width = self.shape
        beyond = (max(0, height - repeated.shape[0]), max(0, width - repeated.shape[1]))
        padded = np.pad(repeated, ((0, beyond[0]), (0, beyond[1])), mode="edge")
        return cast(Bools, padded[:height, :width].astype(np.bool_))
