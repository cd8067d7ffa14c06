"""A screen of the loopback rig that a test draws on."""

import time

import numpy as np

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
