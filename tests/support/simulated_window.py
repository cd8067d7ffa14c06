"""Screens without a display: a projector that replaces a window, and the loopback rig's, which a test draws on."""

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


SIZE = (6, 4)


class FakeScreen:
    """A screen that a test draws on; `looked_s`: time of the last look at it."""

    def __init__(self) -> None:
        self.level = 0
        self.looked_s = 0.0

    def pixels(self) -> np.ndarray:
        self.looked_s = time.monotonic()
        return np.full(SIZE[::-1], self.level * 0x010101, np.uint32)


def as_light(image: np.ndarray) -> np.ndarray:
    return image.astype(np.float32)
