"""The bits and the light of all pixels, the frames that they come from, equally bright, and what the decoder of an axis
takes of them.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import STRIP_ROWS, WHOLE, Floats32, Image, Part, Window, Words, in_slices
from scanner.decoding.codes import CodeWords
from scanner.decoding.corrections import (
    CorrectedFrames,
    as_in_patterns,
    extreme,
    fit_bits,
    gains_of_pairs,
    white_and_threshold,
)
from scanner.decoding.light import Sample
from scanner.decoding.sequence_plan import AxisPlan


class CodeImages:
    """The full-size images that the bits of a capture give, and its frames.

    `plan`: what is decoded; `plan_as_shown`: what the projector showed. `codes`: words and contrasts. `white` (H, W):
    the white frame or, without one, the maximum over all frames. `threshold` (H, W): grey level half-way between lit
    and unlit; without black, that of a pair. `peak` (H, W): maximum over the fringe frames, or as `white` without
    fringes. `log_exposure` (H, W): logarithm of each pixel's relative exposure; None if all were exposed alike.
    `gains`: of the patterns that have an inverse. `white_gain`: brightness of white in the patterns relative to the
    white frame; if it differs from 1, `white` and `threshold` are those of the patterns.

    `sample`: of all `frames`.
    """

    def __init__(self, frames: CorrectedFrames, sample: Sample, log_exposure: Floats32 | None = None) -> None:
        plan = self.plan = self.plan_as_shown = frames.plan
        self._frames = frames
        self._equalisers: dict[int, Callable[[Image, Part], NDArray[Any]]] = {}
        self._first = {plan.shown.index(index): index for index in plan.shown}
        self.gains = gains_of_pairs(plan, sample)
        for pair, gains in self.gains.items():
            if gains.are_harmful:
                self.equalise(pair, gains.equalised)
        self._bits, self.white_gain = fit_bits(plan, sample)
        shape, dtype = sample.shape, sample.level(plan.shown[0]).dtype
        self.codes = [
            CodeWords(code, shape, dtype, contrast=not axis.fringes) for axis in plan.axes for code in axis.codes
        ]
        self.log_exposure = log_exposure
        self.white: Image = np.empty(shape, dtype)
        self.threshold: Image = np.empty(shape, dtype)
        self.peak: Image = np.empty(shape, dtype) if plan.fringes else self.white
        in_slices(shape[0], STRIP_ROWS, self._fold)

    def _fold(self, rows: slice) -> None:
        """Fill in some rows."""
        frames = dict(self.equalised((rows, slice(None))))
        thresholds = self.thresholds(frames)
        for code_words in self.codes:
            code_words.fill(frames, thresholds, rows)
        ends = white_and_threshold(self.plan, frames)
        self.white[rows], self.threshold[rows] = as_in_patterns(*ends, self.white_gain)
        steps = [frames[frame] for frame in self.plan.fringe_frames]
        if steps:
            self.peak[rows] = extreme(np.maximum, steps)

    def thresholds(self, frames: Mapping[int, Image]) -> dict[int, Image]:
        """Return the thresholds of bits without an inverse, by the frame's index, where all `frames` are shown."""
        white, threshold = white_and_threshold(self.plan_as_shown, frames)
        return {frame: bit.threshold(threshold, white) if bit else threshold for frame, bit in self._bits.items()}

    def equalised(
        self, part: Part = WHOLE, frames: Collection[int] | None = None
    ) -> Iterator[tuple[int, NDArray[Any]]]:
        """Yield the index of each pattern, or of some, and a part of its image, equalised."""
        places = [place for place, index in self._first.items() if frames is None or index in frames]
        for place, frame in zip(places, self._frames.read(part, places), strict=True):
            index = self._first[place]
            yield index, self._equalisers[index](frame, part) if index in self._equalisers else frame

    def stacked(self, part: Window, frames: Collection[int]) -> tuple[NDArray[Any], dict[int, int], tuple[int, int]]:
        """Return a stack (N, ...) that holds some frames, by index, as `equalised`; the place of each in it; and the
        row and column at which the part begins in it.

        The frames as they were kept, if they are not corrected.
        """
        if not self._frames.corrections.are_any and not self._equalisers.keys() & {*frames}:
            kept = {index: place for place, index in self._first.items() if index in frames}
            return self._frames.taken, kept, (part[0].start, part[1].start)
        order = [index for index in self._first.values() if index in frames]
        # Fringes that were equalised are no whole grey levels any more.
        kinds = {frame.dtype for _, frame in self.equalised((slice(0, 1), slice(0, 1)), order)}
        stack = np.empty((len(order), *self.threshold[part].shape), np.result_type(np.uint8, *kinds))
        for place, (_, frame) in enumerate(self.equalised(part, order)):
            stack[place] = frame
        return stack, {index: place for place, index in enumerate(order)}, (0, 0)

    def equalise(self, group: Sequence[int], by: Callable[[int, Image, Part], NDArray[Any]]) -> None:
        """Equalise a group of frames from now on, each by its number in the group."""
        self._equalisers |= {frame: partial(by, number) for number, frame in enumerate(group)}

    def with_edges(self, axis: AxisPlan) -> CodeWords | None:
        """Return the finest code of an axis whose stripe edges bound its cells; None with fringes, or if there is none.

        Most edges of an XOR code bound no cell. If blur removes the finest stripes, the edges of the next bit are
        displaced too.
        """
        whole = [] if self.plan_as_shown.fringes else [code for code in self.plan_as_shown.codes if code.base is None]
        all_words = [
            code_words for code_words in self.codes if code_words.code in axis.codes and code_words.code in whole
        ]
        return min(all_words, key=lambda code_words: code_words.code.cell, default=None)

    def decode_as(self, codes: Sequence[CodeWords]) -> None:
        """Replace the codes by these, one for one."""
        x, y = (
            replace(axis, codes=tuple(n.code for o, n in zip(self.codes, codes, strict=True) if o.code in axis.codes))
            for axis in self.plan.axes
        )
        self.plan, self.codes = replace(self.plan, x=x, y=y), list(codes)

    def forget_contrasts(self) -> None:
        """Let go of everything but the words of the codes."""
        for code_words in self.codes:
            code_words.forget_contrasts()

    def forget_fringes(self) -> None:
        """Drop the fringes and decode the codes alone; white and black show what is lit."""
        x, y = (replace(axis, fringes=()) for axis in self.plan.axes)
        self.plan = replace(self.plan, x=x, y=y)
        half = cv2.subtract(self.white, self.threshold)
        for code_words in self.codes:
            code_words.contrast = cast(Image, cv2.add(half, half))


@dataclass(frozen=True)
class Signals:
    """The signals of one axis at P pixels, which form an image, row by row."""

    shape: tuple[int, int]
    """(H, W) of the image."""
    words: list[Words]
    """Per code, (P,)."""
    least: Floats32
    """(codes, P): as in `CodeWords`, without the optional bits; empty if the fringes correct wrong bits."""
    contrast: Floats32
    """(codes, P): as in `CodeWords`, empty with fringes."""
    fine: list[dict[int, Image]]
    """Per code, the contrast (P,) of each optional bit, by bit."""
    steps: list[tuple[NDArray[Any], Floats32]]
    """Per fringe, longest period first, the levels of its frames (N, P), and the weights (2, N) with which they add up
    to its components.
    """
    white: Floats32
    """(P,): grey level when lit."""
    threshold: Floats32
    """(P,): grey level half-way between lit and unlit."""
    peak: Image
    """(P,): maximum over the fringes."""
    log_exposure: Floats32 | None = None
    """(P,): None if all pixels were exposed alike."""

    def fringe(self, number: int) -> Floats32:
        """Return A cos θ and A sin θ of a fringe in grey levels, (2, P)."""
        levels, weights = self.steps[number]
        return weights @ levels.astype(np.float32)


def signals_of(
    code_images: CodeImages,
    select: Callable[[NDArray[Any]], NDArray[Any]],
    level: Callable[[int], NDArray[Any]],
    axes: Sequence[AxisPlan] | None = None,
) -> Iterator[Signals]:
    """Return the signals of x, then of y, or of other `axes`, at the pixels that `select` picks from an (H, W) image,
    as a 2-D array, and at which `level` returns a frame.
    """
    threshold, peak, log_exposure = select(code_images.threshold), select(code_images.peak), code_images.log_exposure
    shape = threshold.shape[0], threshold.shape[1]
    white, half_lit = _stack([select(code_images.white), threshold], shape)
    exposure = None if log_exposure is None else select(log_exposure).reshape(-1)

    def of_axis(axis: AxisPlan) -> Signals:
        codes = [code_words for code_words in code_images.codes if code_words.code in axis.codes]
        return Signals(
            shape,
            [select(code_words.words).reshape(-1) for code_words in codes],
            _stack([] if axis.corrects_bits else [select(code_words.least_needed) for code_words in codes], shape),
            _stack([select(code_words.contrast) for code_words in codes if code_words.contrast is not None], shape),
            [{bit: select(image).reshape(-1) for bit, image in code_words.optional.items()} for code_words in codes],
            [
                (np.stack([level(frame) for frame in fringe.frames]).reshape(len(fringe.frames), -1), fringe.weights32)
                for fringe in axis.fringes
            ],
            white,
            half_lit,
            np.ascontiguousarray(peak).reshape(-1),
            exposure,
        )

    return map(of_axis, axes or code_images.plan.axes)


def signals_in(code_images: CodeImages, part: Part) -> Iterator[Signals]:
    """Return the signals of x, then of y, in a part of the image."""
    frames = dict(code_images.equalised(part, code_images.plan.fringe_frames))
    return signals_of(code_images, lambda image: image[part], frames.__getitem__)


def _stack(images: Sequence[NDArray[Any]], shape: tuple[int, int]) -> Floats32:
    """Stack images of one shape to (images, P)."""
    stack = np.empty((len(images), *shape), np.float32)
    for row, image in zip(stack, images, strict=True):
        row[:] = image
    return stack.reshape(len(images), shape[0] * shape[1])
