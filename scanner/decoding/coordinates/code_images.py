"""The bits and the light of all pixels, the frames that they come from, equally bright, and what the decoder of an axis
takes of them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import STRIP_ROWS, Floats32, Image, Part, Words, in_slices
from scanner.decoding.codes import CodeWords
from scanner.decoding.corrections import (
    BitLevels,
    CorrectedFrames,
    as_in_patterns,
    extreme,
    white_and_threshold,
)
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan


@dataclass(frozen=True)
class CodeImages:
    """The full-size images that the bits of a capture give, and its frames."""

    plan: SequencePlan
    """What is decoded; that of the frames is what the projector showed."""
    frames: CorrectedFrames
    """Equally bright."""
    codes: list[CodeWords]
    """Words and contrasts; emptied once they are decoded."""
    bits: Mapping[int, BitLevels | None]
    """The levels of each bit without an inverse, by its frame."""
    white: Image
    """(H, W): the white frame or, without one, the maximum over all frames; as bright as in the patterns."""
    threshold: Image
    """(H, W): grey level half-way between lit and unlit, in the patterns; without black, that of a pair."""
    peak: Image
    """(H, W): maximum over the fringe frames, or as `white` without fringes."""
    log_exposure: Floats32 | None = None
    """(H, W): logarithm of each pixel's relative exposure; None if all were exposed alike."""

    @classmethod
    def fold(
        cls,
        frames: CorrectedFrames,
        bits: Mapping[int, BitLevels | None],
        white_gain: float,
        log_exposure: Floats32 | None = None,
    ) -> Self:
        """Return the images of all frames.

        `white_gain`: brightness of white in the patterns relative to the white frame.
        """
        plan, shape, dtype = frames.plan, frames.taken.shape[1:], frames.dtype
        codes = [CodeWords(code, shape, dtype, contrast=not axis.fringes) for axis in plan.axes for code in axis.codes]
        white, threshold = np.empty(shape, dtype), np.empty(shape, dtype)
        peak = np.empty(shape, dtype) if plan.fringes else white

        def fill(rows: slice) -> None:
            levels = dict(frames.by_number((rows, slice(None))))
            thresholds = thresholds_of(plan, bits, levels)
            for code_words in codes:
                code_words.fill(levels, thresholds, rows)
            white[rows], threshold[rows] = as_in_patterns(*white_and_threshold(plan, levels), white_gain)
            if plan.fringes:
                peak[rows] = extreme(np.maximum, [levels[frame] for frame in plan.fringe_frames])

        in_slices(shape[0], STRIP_ROWS, fill)
        return cls(plan, frames, codes, bits, white, threshold, peak, log_exposure)

    def thresholds(self, part: Part) -> dict[int, Image]:
        """Return the thresholds of bits without an inverse, by the frame's number, in a part of the image."""
        return thresholds_of(self.frames.plan, self.bits, dict(self.frames.by_number(part)))

    def with_edges(self, axis: AxisPlan) -> CodeWords | None:
        """Return the finest code of an axis whose stripe edges bound its cells; None with fringes, or if there is none.

        Most edges of an XOR code bound no cell. If blur removes the finest stripes, the edges of the next bit are
        displaced too.
        """
        plan = self.frames.plan
        whole = [] if plan.fringes else [code for code in plan.codes if code.base is None]
        all_words = [
            code_words for code_words in self.codes if code_words.code in axis.codes and code_words.code in whole
        ]
        return min(all_words, key=lambda code_words: code_words.code.cell, default=None)

    def decoded_as(self, codes: Sequence[CodeWords]) -> "CodeImages":
        """Return the images with the codes replaced by these, one for one."""
        x, y = (
            replace(axis, codes=tuple(n.code for o, n in zip(self.codes, codes, strict=True) if o.code in axis.codes))
            for axis in self.plan.axes
        )
        return replace(self, plan=replace(self.plan, x=x, y=y), codes=list(codes))

    def release_contrasts(self) -> None:
        """Let go of everything but the words of the codes."""
        for code_words in self.codes:
            code_words.release_contrasts()

    def without_fringes(self) -> "CodeImages":
        """Return the images for the codes alone, of which white and black show what is lit."""
        x, y = (replace(axis, fringes=()) for axis in self.plan.axes)
        half = cv2.subtract(self.white, self.threshold)
        codes = [code_words.with_contrast(cast(Image, cv2.add(half, half))) for code_words in self.codes]
        return replace(self, plan=replace(self.plan, x=x, y=y), codes=codes)


def thresholds_of(
    plan: SequencePlan, bits: Mapping[int, BitLevels | None], frames: Mapping[int, Image]
) -> dict[int, Image]:
    """Return the thresholds of bits without an inverse, by the frame's number, where all `frames` (...) are shown."""
    white, threshold = white_and_threshold(plan, frames)
    return {frame: bit.threshold(threshold, white) if bit else threshold for frame, bit in bits.items()}


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
    frames = dict(code_images.frames.by_number(part, code_images.plan.fringe_frames))
    return signals_of(code_images, lambda image: image[part], frames.__getitem__)


def _stack(images: Sequence[NDArray[Any]], shape: tuple[int, int]) -> Floats32:
    """Stack images of one shape to (images, P)."""
    stack = np.empty((len(images), *shape), np.float32)
    for row, image in zip(stack, images, strict=True):
        row[:] = image
    return stack.reshape(len(images), shape[0] * shape[1])
