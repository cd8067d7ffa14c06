"""Fold frames into full-size running images as they arrive.

A Gray code bit is one comparison of two frames. A fringe is two differences, or two weighted sums. A frame waits until
the frame that it is compared with, or its threshold, is available.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image
from scanner.decoding.arrays import Floats32, Part
from scanner.decoding.codes.gray_fold import GrayFold
from scanner.decoding.fringes.fringe_fold import FringeFold
from scanner.decoding.light.bits_without_inverse import BitLevels, levels_of_bit, white_of
from scanner.decoding.light.brightness import Gains
from scanner.decoding.light.equalise import PairEqualiser
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan

# Yields the index and the image of each pattern in a part of the picture.
Frames = Callable[[Part], Iterable[tuple[int, Image]]]


class Accumulators:
    """The full-size running images of the frames added so far.

    `brightest` (H, W): the white frame or, without one, the maximum over all frames. `log_exposure` (H, W): logarithm
    of each pixel's relative exposure; None if all were exposed alike.
    """

    def __init__(self, plan: SequencePlan, first: Image, pairs: PairEqualiser, pixels: NDArray[np.int64]) -> None:
        self.plan = self._shown = plan
        self._equaliser, self._pixels = pairs, pixels
        self._of_bits: list[BitLevels] = []
        self._thresholds: dict[int, Image] = {}
        self.log_exposure: Floats32 | None = None
        shape = first.shape[0], first.shape[1]
        self.codes = [
            GrayFold(code, shape, first.dtype, contrast=not axis.fringes) for axis in plan.axes for code in axis.codes
        ]
        self._waiting: dict[int, Image] = {}  # references to the stored frames, no copies
        self.fringes = [FringeFold(fringe, shape, first.dtype, self._waiting) for fringe in plan.fringes]
        self.brightest: Image = np.zeros(shape, first.dtype)
        self._white: Image | None = None
        self._black: Image | None = None
        self._fringe_peak: Image | None = np.zeros(shape, first.dtype) if plan.fringes else None
        self._darkest: Image | None = first.copy() if _needs_midrange(plan) else None
        self._threshold: Image | None = None
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
        """Fold in frame `index`, (H, W), which must not be modified afterwards."""
        if index in self._steps:
            fold, step = self._steps[index]
            fold.fold(step, grey, self.peak)
        elif index in self._pair_of:
            self._add_of_pair(index, grey)
        elif index in self._alone:
            self._waiting[index] = grey
        elif index == self.plan.white:
            self._white = self.brightest = grey.copy()
        else:
            self._black = grey
        if self.plan.white is None:
            np.maximum(self.brightest, grey, out=self.brightest)
        if self._darkest is not None:
            np.minimum(self._darkest, grey, out=self._darkest)
        self._fold_alone()

    def alike(self, frames: Iterable[Image], part: Part) -> Iterator[tuple[int, Image]]:
        """Yield the index and the image of each pattern, equalised as it was folded.

        `frames`: a part of all frames of the capture, in the order in which they were shown.
        """
        found = self._equaliser.found
        for place, frame in enumerate(frames):
            index = self.plan.shown[place]
            if index in self.plan.shown[:place]:
                continue
            pair = self._pair_of.get(index)
            if pair in found and found[pair].are_harmful:
                yield index, found[pair].equalised(pair.index(index), frame, part[0])
            else:
                yield index, frame

    def thresholds_in(self, part: Part) -> dict[int, Image]:
        """Return, without fringes, the threshold of each bit without an inverse in a part, by the frame's index."""
        return {index: image[part] for index, image in self._thresholds.items()}

    def with_edges(self, axis: AxisPlan) -> GrayFold | None:
        """Return the finest code of an axis whose stripe edges bound its cells; None with fringes, or if there is none.

        Most edges of an XOR code bound no cell. If blur removes the finest stripes, the edges of the next bit are
        displaced too.
        """
        whole = [] if self._shown.fringes else [code for code in self._shown.codes if code.base is None]
        folds = [fold for fold in self.codes if fold.code in axis.codes and fold.code in whole]
        return min(folds, key=lambda fold: fold.code.cell, default=None)

    def finish(self) -> float:
        """Fold in the frames whose threshold needs the whole sequence.

        Returns the brightness of white in the patterns relative to the white frame. If it differs from 1, `brightest`
        and `middle` are replaced by those of the patterns.
        """
        if self._darkest is not None:
            self._threshold = _mean(self.brightest, self._darkest)
        self._fold_alone()
        self._waiting.clear()
        white = white_of(self._of_bits)
        if white != 1:
            seen, middle = self.brightest, self.middle
            self.brightest = cast(Image, cv2.addWeighted(seen, 2 * white - 1, middle, 2 - 2 * white, 0))
            self.middle = cast(Image, cv2.addWeighted(seen, white - 1, middle, 2 - white, 0))
        return white

    def decode_as(self, codes: Sequence[GrayFold]) -> None:
        """Replace the codes by these, one for one."""
        x, y = (
            replace(axis, codes=tuple(n.code for o, n in zip(self.codes, codes, strict=True) if o.code in axis.codes))
            for axis in self.plan.axes
        )
        self.plan, self.codes = replace(self.plan, x=x, y=y), list(codes)

    def forget_fringes(self) -> None:
        """Drop the fringes and decode the codes alone; white and black show what is lit."""
        x, y = (replace(axis, fringes=()) for axis in self.plan.axes)
        self.plan, self.fringes = replace(self.plan, x=x, y=y), []
        half = cv2.subtract(self.brightest, self.middle)
        for fold in self.codes:
            fold.contrast = cast(Image, cv2.add(half, half))

    def forget_peaks(self, saturation: float) -> None:
        """Replace the peaks of the fringes by their maximum if none is clipped."""
        if self._fringe_peak is not None and (largest := self._fringe_peak.max()) < saturation:
            self._fringe_peak = np.broadcast_to(largest, self._fringe_peak.shape)

    @property
    def gains_of_pairs(self) -> dict[tuple[int, int], Gains]:
        """The gains of the patterns that have an inverse."""
        return self._equaliser.found

    @property
    def peak(self) -> Image:
        """(H, W): maximum over the fringe frames, or over all frames if there are no fringes."""
        return self.brightest if self._fringe_peak is None else self._fringe_peak

    @cached_property
    def middle(self) -> Image:
        """(H, W): grey level half-way between lit and unlit, once all frames are in; without black, that of a pair."""
        black, self._black = self._black, None
        if black is None and self._threshold is not None:
            return self._threshold
        darkest = self._darkest if black is None else black
        return self.brightest // 2 if darkest is None else _mean(self.brightest, darkest)

    def _add_of_pair(self, index: int, grey: Image) -> None:
        normal, inverse = pair = self._pair_of[index]
        other = self._waiting.pop(inverse if index == normal else normal, None)
        if other is None:
            self._waiting[index] = grey
            return
        bright, dark = (grey, other) if index == normal else (other, grey)
        gains = self._equaliser.gains(pair)
        if gains is not None:
            bright, dark = (gains.equalised(k, image, slice(None)) for k, image in enumerate((bright, dark)))
        for fold, bit in self._pairs[pair]:
            fold.fold(bit, bright, dark)
        if self._threshold is None and (self._alone or self.plan.black is None):
            self._threshold = _mean(bright, dark)

    def _fold_alone(self) -> None:
        """Fold in the bits without an inverse as soon as their threshold is known."""
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
            if not self._shown.fringes:
                self._thresholds[index] = threshold
            for fold, bit in self._alone[index]:
                bright, dark = (threshold, frame) if bit in fold.code.inverse else (frame, threshold)
                fold.fold(bit, bright, dark, half=True)


def _needs_midrange(plan: SequencePlan) -> bool:
    """Whether the half-way level can only be taken from the extremes over all frames."""
    return not plan.complements


def _mean(first: Image, second: Image) -> Image:
    return cast(Image, cv2.addWeighted(first, 0.5, second, 0.5, 0))
