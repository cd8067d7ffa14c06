"""Fold the bits of a Gray code into code words."""

from collections.abc import Iterator, Mapping
from copy import copy
from typing import Any

import cv2
import numpy as np

from calib.numerics import Bools, Image, Words
from scanner.decoding.sequence_plan import FINE_BITS, GrayCode


class GrayFold:
    """The code word of each pixel, with the contrast of its bits.

    `words` (H, W): of the plain Gray code, bit 0 in place bits − 1, as in the pattern. `least` and `contrast` (H, W):
    smallest and largest |bright − dark| among the bits, in grey levels. `contrast` is None where fringes show what is
    lit. Without fringes, each of the finest bits has its own contrast image in `fine`, by bit, and is not included in
    `least`: whether the camera resolves it is decided later. It may then become `optional`.
    """

    def __init__(self, code: GrayCode, shape: tuple[int, int], dtype: np.dtype[Any], *, contrast: bool) -> None:
        self.code = code
        self.contrast: Image | None = np.zeros(shape, dtype) if contrast else None
        self.least: Image = np.full(shape, np.iinfo(dtype).max, dtype)
        keeps_fine = contrast and code.base is None and code.bits > FINE_BITS
        fine = range(code.bits - FINE_BITS, code.bits) if keeps_fine else ()
        self.fine: dict[int, Image] = {bit: self.least.copy() for bit in fine if code.frames_of([bit])}
        self.optional: dict[int, Image] = {}
        self._least_of_others = self.least
        words = next(kind for kind in (np.uint8, np.uint16, np.uint32) if np.iinfo(kind).bits >= code.bits)
        self.words: Words = np.full(shape, code.constant, words)

    def fold(self, frames: Mapping[int, Image], thresholds: Mapping[int, Image], rows: slice = slice(None)) -> None:
        """Fill in some rows, from their frames, and from the thresholds of bits without an inverse."""
        words = self.words[rows]
        for bit, bright, dark in compared(self.code, frames, thresholds):
            shown = cv2.compare(bright, dark, cv2.CMP_GT).view(np.int8)  # all bits are set, or none
            words |= shown.astype(words.dtype) & words.dtype.type(1 << self.code.bits - 1 - bit)
            contrast = cv2.absdiff(bright, dark)
            if bit in self.code.unpaired:
                contrast = cv2.add(contrast, contrast)
            least = self.fine.get(bit, self.least)[rows]
            np.minimum(least, contrast, out=least)
            if self.contrast is not None:
                np.maximum(self.contrast[rows], contrast, out=self.contrast[rows])
        words[:] = self.code.relative_to_base(words)

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
        """Return the coarser code without its `count` finest bits; its `least` covers all its bits.

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


def compared(
    code: GrayCode, frames: Mapping[int, Image], thresholds: Mapping[int, Image]
) -> Iterator[tuple[int, Image, Image]]:
    """Yield each bit that was shown, with its bright and its dark image, from frames by index.

    A bit without an inverse is compared with its frame's threshold.
    """
    for bit in sorted({*code.normal, *code.inverse}):
        normal, inverse = code.normal.get(bit), code.inverse.get(bit)
        bright = thresholds[code.inverse[bit]] if normal is None else frames[normal]
        yield bit, bright, thresholds[code.normal[bit]] if inverse is None else frames[inverse]
