"""A simulated projector that replaces a window on a screen."""

import time
from collections.abc import Callable

import numpy as np

from hw.projector import Screen
from hw.timing import Swap


class SimulatedWindow:
    """A window of (width, height); `show_light` is called with each flipped picture."""

    renderer = "none"

    def __init__(self, size: tuple[int, int], show_light: Callable[[np.ndarray], object]) -> None:
        self.size = size
        self.screen = Screen(0, "screen", 0, 0, *size, 60.0)
        self._show_light = show_light
        self._prepared = np.zeros(size[::-1], np.uint8)

    def prepare(self, image: np.ndarray) -> None:
        self._prepared = image

    def flip(self) -> Swap:
        begun_s = time.monotonic()
        self._show_light(self._prepared)
        return Swap(begun_s, time.monotonic())

    def show(self, image: np.ndarray) -> None:
        self.prepare(image)
        self.flip()
