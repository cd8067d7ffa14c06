"""Frames folded into full-size images as they arrive, so that memory does not grow with their number.

A Gray bit is one compare of two frames. A fringe is two differences, or two weighted sums. Frames wait, as they came,
only for the one that they are compared with, or that gives their threshold.
"""

from collections import defaultdict
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image, compiled
from scanner.decoding.arrays import Floats32, Words
from scanner.decoding.fringes.fringe_fold import FringeFold
from scanner.decoding.light.brightness import Gains
from scanner.decoding.light.equalise import PairEqualiser
from scanner.decoding.light.lone_bits import BitLevels, levels_of_bit, white_of
from scanner.decoding.sequence_plan import GrayCode, SequencePlan

Planes = NDArray[np.uint8]
_NO_BIT = np.uint8(0)
# As many of the finest bits may not be resolved.
_FINE_BITS = 3


class GrayFold:
    """The code word of each pixel, with how far its bits were from their thresholds.

    `least` and `contrast` (H, W): the smallest and largest |bright − dark| among the bits, in grey levels; `contrast`
    is None where fringes tell what is lit. Where none do, the `fine` bits have images of their own, by bit, and are not
    among the `least`: whether the camera resolves them is known in the end. They may then be `optional`.
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
        """Set a bit where `bright` is brighter than `dark`; `half` if one of them is the threshold between two."""
        place, position = divmod(self.code.bits - 1 - bit, 8)
        plane, largest = self._planes[place].reshape(-1), bright.dtype.type(np.iinfo(bright.dtype).max)
        least = self.least
        if self._keeps_fine and 0 < self.code.bits - bit <= _FINE_BITS < self.code.bits:
            least = self.fine.setdefault(bit, np.full_like(self.least, largest))
        bright, dark = bright.reshape(-1), dark.reshape(-1)
        _note_bit(bright, dark, np.uint8(1 << position), half, largest, plane, least.reshape(-1))
        if self.contrast is not None:
            _note_contrast(bright, dark, half, largest, self.contrast.reshape(-1))

    @cached_property
    def words(self) -> Words:
        """(H, W): the plain Gray code's, bit 0 in place bits − 1, as in the pattern; once all frames are in."""
        planes, self._planes = self._planes, []
        if len(planes) == 1:
            return self.code.relative_to_base(planes[0])
        merged = cast(Words, cv2.merge(planes))
        words: Words = merged.view("<u2" if len(planes) == 2 else "<u4")[..., 0]
        return self.code.relative_to_base(words)

    @property
    def least_needed(self) -> Image:
        """(H, W): the smallest contrast among the bits that no pixel can do without."""
        return self._least_of_others if self.optional else self.least

    def without_finest(self, count: int, *, optional: bool = False) -> "GrayFold":
        """The coarser code that the other bits are, once all frames are in; its `least` is that of all its bits.

        `optional`: a pixel may do without some of the fine bits that are left.
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

    Of the frame and a threshold half-way, the difference is doubled, as far as numbers go.
    """
    for i in range(len(bright)):
        one, other = bright[i], dark[i]
        plane[i] = plane[i] | (bit if one > other else _NO_BIT)
        difference = one - other if one > other else other - one
        if half:
            difference = difference + difference if difference <= largest // 2 else largest
        least[i] = difference if difference < least[i] else least[i]


@compiled
def _note_contrast(bright: Image, dark: Image, half: bool, largest: np.unsignedinteger[Any], contrast: Image) -> None:
    """Raise `contrast` to the same difference; (P,)."""
    for i in range(len(bright)):
        one, other = bright[i], dark[i]
        difference = one - other if one > other else other - one
        if half:
            difference = difference + difference if difference <= largest // 2 else largest
        contrast[i] = difference if difference > contrast[i] else contrast[i]


class Accumulators:
    """All that is kept at full size of the frames seen so far.

    `brightest` (H, W): the white frame or, without one, the maximum over all frames. `log_exposure` (H, W): logarithm
    of the pixels' exposures, relative to each other; None if they are all alike.
    """

    def __init__(self, plan: SequencePlan, first: Image, pairs: PairEqualiser, pixels: NDArray[np.int64]) -> None:
        self.plan = plan
        self._equaliser, self._pixels = pairs, pixels
        self._of_bits: list[BitLevels] = []
        self.log_exposure: Floats32 | None = None
        shape = first.shape[0], first.shape[1]
        self.codes = [
            GrayFold(code, shape, first.dtype, contrast=not axis.fringes) for axis in plan.axes for code in axis.codes
        ]
        self.fringes = [FringeFold(fringe, shape, first.dtype) for fringe in plan.fringes]
        self.brightest: Image = np.zeros(shape, first.dtype)
        self._white: Image | None = None
        self._black: Image | None = None
        self._fringe_peak: Image | None = np.zeros(shape, first.dtype) if plan.fringes else None
        self._darkest: Image | None = first.copy() if _needs_midrange(plan) else None
        self._threshold: Image | None = None
        self._waiting: dict[int, Image] = {}
        # The base of an XOR code may be a bit of a plain one, too.
        self._pairs: dict[tuple[int, int], list[tuple[GrayFold, int]]] = defaultdict(list)
        self._alone: dict[int, list[tuple[GrayFold, int]]] = defaultdict(list)
        for fold in self.codes:
            for bit, pair in fold.code.pairs.items():
                self._pairs[pair].append((fold, bit))
            for bit, frame in fold.code.unpaired.items():
                self._alone[frame].append((fold, bit))
        self._pair_of = {frame: pair for pair in self._pairs for frame in pair}
        self._steps = {frame: (fold, step) for fold in self.fringes for step, frame in enumerate(fold.fringe.frames)}

    def add(self, index: int, grey: Image) -> None:
        """Fold in frame `index`, (H, W); what is kept of it is a copy."""
        if index in self._steps:
            fold, step = self._steps[index]
            fold.fold(step, grey, self.peak)
        elif index in self._pair_of:
            self._add_of_pair(index, grey)
        elif index in self._alone:
            self._waiting[index] = grey.copy()
        elif index == self.plan.white:
            self._white = self.brightest = grey.copy()
        else:
            self._black = grey.copy()
        if self.plan.white is None:
            np.maximum(self.brightest, grey, out=self.brightest)
        if self._darkest is not None:
            np.minimum(self._darkest, grey, out=self._darkest)
        self._fold_alone()

    def finish(self) -> float:
        """Fold in what waited for the whole sequence to give its threshold.

        Returns how bright white is in the patterns, in parts of the white frame; if that is another white, it is from
        then on the one of the patterns.
        """
        if self._darkest is not None:
            self._threshold = _mean(self.brightest, self._darkest)
        self._fold_alone()
        white = white_of(self._of_bits)
        if white != 1:
            seen, middle = self.brightest, self.middle
            self.brightest = cast(Image, cv2.addWeighted(seen, 2 * white - 1, middle, 2 - 2 * white, 0))
            self.middle = cast(Image, cv2.addWeighted(seen, white - 1, middle, 2 - white, 0))
        return white

    def decode_as(self, codes: Sequence[GrayFold]) -> None:
        """Go on with these in place of the codes that were shown, one for one."""
        x, y = (
            replace(axis, codes=tuple(n.code for o, n in zip(self.codes, codes, strict=True) if o.code in axis.codes))
            for axis in self.plan.axes
        )
        self.plan, self.codes = replace(self.plan, x=x, y=y), list(codes)

    def forget_fringes(self) -> None:
        """Go on with the codes alone; white and black tell what is lit."""
        x, y = (replace(axis, fringes=()) for axis in self.plan.axes)
        self.plan, self.fringes = replace(self.plan, x=x, y=y), []
        half = cv2.subtract(self.brightest, self.middle)
        for fold in self.codes:
            fold.contrast = cast(Image, cv2.add(half, half))

    def forget_contrasts(self) -> None:
        """Free the bits' distances from their thresholds where the fringes contradict wrong bits anyway."""
        for axis in self.plan.axes:
            for fold in self.codes:
                if axis.corrects_bits and fold.code in axis.codes:
                    fold.least = fold.least[:0].copy()

    @property
    def gains_of_pairs(self) -> dict[tuple[int, int], Gains]:
        """Of the patterns that have an inverse."""
        return self._equaliser.found

    @property
    def peak(self) -> Image:
        """(H, W): the largest grey levels among the fringes, or among all frames where there are no fringes."""
        return self.brightest if self._fringe_peak is None else self._fringe_peak

    @cached_property
    def middle(self) -> Image:
        """(H, W): grey level half-way between lit and unlit, once all frames are in: that of a pair, without black."""
        black, self._black = self._black, None
        if black is None and self._threshold is not None:
            return self._threshold
        darkest = self._darkest if black is None else black
        return self.brightest // 2 if darkest is None else _mean(self.brightest, darkest)

    def _add_of_pair(self, index: int, grey: Image) -> None:
        normal, inverse = pair = self._pair_of[index]
        other = self._waiting.pop(inverse if index == normal else normal, None)
        if other is None:
            self._waiting[index] = grey.copy()
            return
        bright, dark = (grey, other) if index == normal else (other, grey)
        gains = self._equaliser.gains(pair)
        if gains is not None:
            bright, dark = gains.equalised(0, bright), gains.equalised(1, dark)
        for fold, bit in self._pairs[pair]:
            fold.fold(bit, bright, dark)
        if self._threshold is None and (self._alone or self.plan.black is None):
            self._threshold = _mean(bright, dark)

    def _fold_alone(self) -> None:
        """Fold in the bits without an inverse as soon as there is a threshold for them."""
        if not self._alone:
            return
        if self._threshold is None and self._white is not None and self._black is not None:
            self._threshold = _mean(self._white, self._black)
        if self._threshold is None:
            return
        for index in [index for index in self._waiting if index in self._alone]:
            frame = self._waiting.pop(index)
            threshold, levels = self._threshold, levels_of_bit(frame, self._threshold, self.brightest, self._pixels)
            if levels is not None:
                threshold = levels.threshold(threshold, self.brightest)
                self._of_bits.append(levels)
            for fold, bit in self._alone[index]:
                bright, dark = (threshold, frame) if bit in fold.code.inverse else (frame, threshold)
                fold.fold(bit, bright, dark, half=True)


def _needs_midrange(plan: SequencePlan) -> bool:
    """Whether nothing but the extremes over all frames tells what is half-way between lit and unlit."""
    return not plan.complements


def _mean(first: Image, second: Image) -> Image:
    return cast(Image, cv2.addWeighted(first, 0.5, second, 0.5, 0))
