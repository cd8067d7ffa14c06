"""The amplitude of fringes, as the camera sees it: what two lenses have left of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Image, grey
from hw.rig import Frame
from scanner.patterns import Axis, Pattern, Phase

STEPS = 4
_SHIFTS = {step / STEPS for step in range(STEPS)}
# Cells of the camera's image over which amplitudes are averaged.
CELLS_ACROSS = 24


@dataclass(frozen=True)
class FringePower:
    """A fringe of one axis and period: mean square amplitude of each camera pixel's sine over 4 steps, and the noise in
    it; (H, W), in squared grey levels.
    """

    power: NDArray[np.float32]
    noise: NDArray[np.float32]


class FringeMeter:
    """Measures every fringe of four equal steps among the frames that pass.

    `fringes`: the measured ones, by axis and period in projector pixels.
    """

    def __init__(self) -> None:
        self.fringes: dict[tuple[Axis, float], FringePower] = {}
        self._frames: dict[tuple[Axis, float], dict[float, Image]] = {}

    def watch(self, frames: Iterator[tuple[Pattern, Frame]]) -> Iterator[tuple[Pattern, Frame]]:
        """Pass frames on."""
        for pattern, frame in frames:
            self.add(pattern, frame.image)
            yield pattern, frame

    def add(self, pattern: Pattern, image: Image) -> None:
        """Take note of a frame, if it is of a fringe; frames are kept only until a fringe is complete."""
        if not isinstance(pattern, Phase):
            return
        key = (pattern.axis, pattern.period)
        steps = self._frames.setdefault(key, {})
        steps[pattern.shift] = image
        if set(steps) == _SHIFTS:
            self.fringes[key] = _fringe([grey(steps[shift]).astype(np.float32) for shift in sorted(_SHIFTS)])
            del self._frames[key]


def _fringe(steps: Sequence[NDArray[np.float32]]) -> FringePower:
    """Amplitude and noise of I_n = m + A cos(φ + nπ/2).

    Opposite steps differ by 2A cos φ and 2A sin φ, and the sums of opposite steps are equal. The difference of these
    sums is noise (and the second harmonic, which blur removes from short fringes). A quarter of its square is the
    variance of one frame, which is also the contribution of noise to the squared amplitude.
    """
    first, second, third, fourth = steps
    power = ((first - third) ** 2 + (second - fourth) ** 2) / 4
    noise = (first + third - second - fourth) ** 2 / 4
    return FringePower(power.astype(np.float32), noise.astype(np.float32))


def cell_size(shape: tuple[int, int]) -> int:
    """Side of a cell in camera pixels, for an image of (H, W)."""
    return max(4, round(shape[1] / CELLS_ACROSS))


def smoothed(image: Floats, size: int) -> Floats:
    """Mean over squares of `size` pixels around each pixel, (H, W)."""
    return cast(Floats, cv2.blur(image, (size, size)))
