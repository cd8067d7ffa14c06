"""The amplitude of fringes, as the camera sees it: what two lenses have left of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from calib.arrays import Floats, Image
from hw.rig import Frame
from scanner.checking.light import grey
from scanner.patterns import Axis, Pattern, Phase

STEPS = 4
# Cells of the camera's image over which amplitudes are averaged.
CELLS_ACROSS = 24


@dataclass(frozen=True)
class Fringe:
    """Of one axis and period: mean square amplitude of each camera pixel's sine over 4 steps, and the part of it that
    is noise; (H, W), in squared grey levels.
    """

    power: Floats
    noise: Floats


class FringeMeter:
    """Looks on while frames go by, and measures every fringe of four equal steps among them."""

    def __init__(self) -> None:
        self._frames: dict[tuple[Axis, float], dict[float, Floats]] = {}

    def watch(self, frames: Iterator[tuple[Pattern, Frame]]) -> Iterator[tuple[Pattern, Frame]]:
        """Pass frames on."""
        for pattern, frame in frames:
            self.add(pattern, frame.image)
            yield pattern, frame

    def add(self, pattern: Pattern, image: Image) -> None:
        """Take note of a frame, if it is of a fringe."""
        if isinstance(pattern, Phase):
            self._frames.setdefault((pattern.axis, pattern.period), {})[pattern.shift] = grey(image).astype(np.float32)

    def fringes(self) -> dict[tuple[Axis, float], Fringe]:
        """What was seen, by axis and period in projector pixels."""
        return {
            key: _fringe([steps[step / STEPS] for step in range(STEPS)])
            for key, steps in self._frames.items()
            if set(steps) == {step / STEPS for step in range(STEPS)}
        }


def _fringe(steps: Sequence[Floats]) -> Fringe:
    """I_n = m + A cos(φ + nπ/2): opposite steps differ by 2A cos φ and 2A sin φ, and the sums of opposites are equal.

    What these sums differ by is noise (and the second harmonic, of which short fringes have none left): a quarter of
    its square is the variance of one frame, which is also what noise adds to the squared amplitude.
    """
    first, second, third, fourth = steps
    power = ((first - third) ** 2 + (second - fourth) ** 2) / 4
    noise = (first + third - second - fourth) ** 2 / 4
    return Fringe(power, noise)


def cell_size(shape: tuple[int, int]) -> int:
    """Side of a cell in camera pixels, for an image of (H, W)."""
    return max(4, round(shape[1] / CELLS_ACROSS))


def smoothed(image: Floats, size: int) -> Floats:
    """Mean over squares of `size` pixels around each pixel, (H, W)."""
    return cast(Floats, cv2.blur(image, (size, size)))
