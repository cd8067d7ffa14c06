"""All frames, subsampled on a regular grid, to find where something moved and how large it is."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Image, Ints
from scanner.decoding.arrays import Floats32

# Along the longer side of the image; objects smaller than a few of these pixels affect few matches.
_MOST_ALONG = 224


@dataclass
class CoarseFrames:
    """Every frame of `shape` (H, W), subsampled to a grid (h, w).

    `are_divided`: whether the brightness of some frames was scaled.
    """

    shape: tuple[int, int]
    are_divided: bool = False
    _frames: list[Image] = field(default_factory=list)

    @cached_property
    def step(self) -> int:
        """Spacing of the grid in camera pixels."""
        return max(1, -(-max(self.shape) // _MOST_ALONG))

    def of(self, image: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return the grid pixels (h, w) of an image (H, W)."""
        half = self.step // 2
        return np.ascontiguousarray(image[half :: self.step, half :: self.step])

    def add(self, grey: Image) -> None:
        """Append a frame (H, W)."""
        self._frames.append(cast(Image, self.of(grey)))

    def divide(self, frame: int, by_row: Floats) -> None:
        """Divide the grey levels of a frame by a factor per row, (h,) or (1,)."""
        self.are_divided = True
        self._frames[frame] = cast(Image, (self._frames[frame] / by_row[:, None]).astype(np.float32))

    @property
    def rows(self) -> Ints:
        """(h,): image rows of the grid rows."""
        return np.arange(self.shape[0])[self.step // 2 :: self.step]

    @property
    def levels(self) -> Floats32:
        """(frames, h, w) grey levels."""
        return np.stack(self._frames, dtype=np.float32)

    def at_full_size(self, chosen: Bools) -> Bools:
        """Enlarge a mask of the grid (h, w) to the image (H, W), by nearest neighbour."""
        repeated = cv2.resize(
            chosen.astype(np.uint8),
            (chosen.shape[1] * self.step, chosen.shape[0] * self.step),
            interpolation=cv2.INTER_NEAREST,
        )
        height, width = self.shape
        beyond = (max(0, height - repeated.shape[0]), max(0, width - repeated.shape[1]))
        padded = np.pad(repeated, ((0, beyond[0]), (0, beyond[1])), mode="edge")
        return cast(Bools, padded[:height, :width].astype(np.bool_))
