"""Fold the bits of a Gray code into code words as their frames arrive."""

from copy import copy
from functools import cached_property
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Image, compiled
from scanner.decoding.arrays import Words
from scanner.decoding.sequence_plan import FINE_BITS, GrayCode

Planes = NDArray[np.uint8]


class GrayFold:
    """The code word of each pixel, with the contrast of its bits.

    `least` and `contrast` (H, W): smallest and largest |bright − dark| among the bits, in grey levels. `contrast` is
    None where fringes show what is lit. Without fringes, each of the finest bits has its own contrast image in `fine`,
    by bit, and is not included in `least`: whether the camera resolves it is decided after all frames. It may then
    become `optional`.
    """

    def __init__(self, code: GrayCode, shape: tuple[int, int], dtype: np.dtype[Any], *, contrast: bool) -> None:
        self.code = code
        self.contrast: Image | None = np.zeros(shape, dtype) if contrast else None
        self.least: Image = np.full(shape, np.iinfo(dtype).max, dtype)
        self.fine: dict[int, Image] = {}
        self.optional: dict[int, Image] = {}
        self._least_of_others = self.least
        self._keeps_fine = contrast and code.base is None
        planes = next(n for n in (1, 2, 4) if 8 * n >= code.bits)
        self._planes = [np.full(shape, code.constant >> 8 * n & 255, np.uint8) for n in range(planes)]

    def fold(self, bit: int, bright: Image, dark: Image, *, half: bool = False) -> None:
        """Set a bit where `bright` is brighter than `dark`; `half` if one of them is the threshold."""
        place, position = divmod(self.code.bits - 1 - bit, 8)
        plane, largest = self._planes[place].reshape(-1), bright.dtype.type(np.iinfo(bright.dtype).max)
        least = self.least
        if self._keeps_fine and 0 < self.code.bits - bit <= FINE_BITS < self.code.bits:
            least = self.fine.setdefault(bit, np.full_like(self.least, largest))
        bright, dark = bright.reshape(-1), dark.reshape(-1)
        _note_bit(bright, dark, np.uint8(1 << position), half, largest, plane, least.reshape(-1))
        if self.contrast is not None:
            _note_contrast(bright, dark, half, largest, self.contrast.reshape(-1))

    @cached_property
    def words(self) -> Words:
        """(H, W): words of the plain Gray code, bit 0 in place bits − 1, as in the pattern; once all frames are in."""
        planes, self._planes = self._planes, []
        if len(planes) == 1:
            return self.code.relative_to_base(planes[0])
        merged = cast(Words, cv2.merge(planes))
        words: Words = merged.view("<u2" if len(planes) == 2 else "<u4")[..., 0]
        return self.code.relative_to_base(words)

    @property
    def least_needed(self) -> Image:
        """(H, W): the smallest contrast among the bits that are not optional."""
        return self._least_of_others if self.optional else self.least

    def decide(self, where: Bools, words: Words, least: Image) -> None:
        """Replace the words and the smallest contrast (H, W) in some pixels (H, W)."""
        np.copyto(self.words, words, where=where)
        for contrast in (self.least, self._least_of_others):
            np.copyto(contrast, least, where=where)
        for contrast in self.optional.values():
            np.maximum(contrast, least, out=contrast, where=where)

    def without_finest(self, count: int, *, optional: bool = False) -> "GrayFold":
        """Return the coarser code without its `count` finest bits, once all frames are in; its `least` covers all its
        bits.

        `optional`: a pixel may lack some of the remaining fine bits.
        """
        other = copy(self)
        other.code, other.fine = self.code.without_finest(count), {}
        other.words = self.words >> self.words.dtype.type(count)
        other.least = self.least.copy()
        for bit, image in self.fine.items():
            if bit < other.code.bits:
                np.minimum(other.least, image, out=other.least)
                if optional:
                    other.optional = {**other.optional, bit: image}
        return other


@compiled
def _note_bit(
    bright: Image, dark: Image, bit: np.uint8, half: bool, largest: np.unsignedinteger[Any], plane: Planes, least: Image
) -> None:
    """Set a bit where one frame is brighter than the other, and lower `least` to their difference; (P,).

    The difference from a half-way threshold is doubled, up to the largest value of the type.
    """
    for i in range(len(bright)):
        one, other = bright[i], dark[i]
        plane[i] = plane[i] | (bit if one > other else np.uint8(0))
        difference = one - other if one > other else other - one
        if half:
            difference = difference + difference if difference <= largest // 2 else largest
        least[i] = difference if difference < least[i] else least[i]


@compiled
def _note_contrast(bright: Image, dark: Image, half: bool, largest: np.unsignedinteger[Any], contrast: Image) -> None:
    """Raise `contrast` to the difference that `_note_bit` uses; (P,)."""
    for i in range(len(bright)):
        one, other = bright[i], dark[i]
        difference = one - other if one > other else other - one
        if half:
            difference = difference + difference if difference <= largest // 2 else largest
        contrast[i] = difference if difference > contrast[i] else contrast[i]
