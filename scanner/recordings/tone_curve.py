"""A camera's tone curve: the light of each code of its video."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats

_SRGB_EXPONENT, _SRGB_TOE = 2.4, 0.055
_CLIPPED = 0.985  # share of the range of codes; compression keeps nothing exactly at the end


@dataclass(frozen=True)
class ToneCurve:
    """Light is ((v + a) / (1 + a)) ** exponent of a level v from 0 to 1 that an S of strength `contrast` was taken off.

    Exponent 2.4 without contrast is sRGB but for its toe (IEC 61966-2-1); a is proportional to the exponent less one,
    so that 1 is linear. `contrast` from −0.9 to 0.9 keeps the curve monotonic.
    """

    exponent: float = _SRGB_EXPONENT
    contrast: float = 0.0

    def light(self, level: Floats) -> Floats:
        """From 0 for the level 0 to 1 for the level 1."""
        straight = level - self.contrast * level * (1 - level) * (2 * level - 1)
        toe = _SRGB_TOE * (self.exponent - 1) / (_SRGB_EXPONENT - 1)
        black = (toe / (1 + toe)) ** self.exponent if toe > 0 else 0.0
        return (((straight + toe) / (1 + toe)) ** self.exponent - black) / (1 - black)


@dataclass(frozen=True)
class LumaCodes:
    """Codes of luma, of which `black` and `white` are the ends."""

    black: int
    white: int

    @cached_property
    def levels(self) -> Floats:
        """(codes,): 0 to 1, clipped."""
        highest = 255
        while highest < self.white:
            highest = 2 * highest + 1
        return np.clip((np.arange(highest + 1) - self.black) / (self.white - self.black), 0, 1)

    def light(self, curve: ToneCurve) -> NDArray[np.float32]:
        """(codes,): the light of each; exactly 1 where it was clipped."""
        light = np.where(self.levels >= _CLIPPED, 1.0, curve.light(self.levels))
        return light.astype(np.float32)
