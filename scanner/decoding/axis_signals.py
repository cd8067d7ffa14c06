"""The signals of one axis at given pixels, in the form that the decoder takes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats32, Image, Part, Words
from scanner.decoding.folded_frames import FoldedFrames
from scanner.decoding.sequence_plan import AxisPlan


@dataclass(frozen=True)
class Signals:
    """The signals of one axis at P pixels, which form an image of `shape` (H, W), row by row.

    `words`: per code, (P,). `least` (codes, P): as in `GrayFold`, empty if the fringes correct wrong bits. `contrast`
    (codes, P): as in `GrayFold`, empty with fringes. `fine`: per code, the contrast (P,) of each optional bit, by bit;
    `least` then covers the other bits. `steps`: per fringe, longest period first, the levels of its frames (N, P), and
    the weights (2, N) with which they add up to its components. `brightest`, `middle` (P,): grey level when lit, and
    half-way between lit and unlit. `peak` (P,): maximum over the fringes. `log_exposure` (P,): None if all pixels were
    exposed alike.
    """

    shape: tuple[int, int]
    words: list[Words]
    least: Floats32
    contrast: Floats32
    fine: list[dict[int, Image]]
    steps: list[tuple[NDArray[Any], Floats32]]
    brightest: Floats32
    middle: Floats32
    peak: Image
    log_exposure: Floats32 | None = None

    def fringe(self, number: int) -> Floats32:
        """Return A cos θ and A sin θ of a fringe in grey levels, (2, P)."""
        levels, weights = self.steps[number]
        return weights @ levels.astype(np.float32)


def signals_of(
    folded: FoldedFrames,
    select: Callable[[NDArray[Any]], NDArray[Any]],
    level: Callable[[int], NDArray[Any]],
    axes: Sequence[AxisPlan] | None = None,
) -> Iterator[Signals]:
    """Return the signals of x, then of y, or of other `axes`, at the pixels that `select` picks from an (H, W) image,
    as a 2-D array, and at which `level` returns a frame.
    """
    middle, peak, log_exposure = select(folded.middle), select(folded.peak), folded.log_exposure
    shape = middle.shape[0], middle.shape[1]
    brightest, half_lit = _stack([select(folded.brightest), middle], shape)
    exposure = None if log_exposure is None else select(log_exposure).reshape(-1)

    def of_axis(axis: AxisPlan) -> Signals:
        codes = [fold for fold in folded.codes if fold.code in axis.codes]
        return Signals(
            shape,
            [select(fold.words).reshape(-1) for fold in codes],
            _stack([] if axis.corrects_bits else [select(fold.least_needed) for fold in codes], shape),
            _stack([select(fold.contrast) for fold in codes if fold.contrast is not None], shape),
            [{bit: select(image).reshape(-1) for bit, image in fold.optional.items()} for fold in codes],
            [
                (np.stack([level(frame) for frame in fringe.frames]).reshape(len(fringe.frames), -1), fringe.weights32)
                for fringe in axis.fringes
            ],
            brightest,
            half_lit,
            np.ascontiguousarray(peak).reshape(-1),
            exposure,
        )

    return map(of_axis, axes or folded.plan.axes)


def signals_in(folded: FoldedFrames, part: Part) -> Iterator[Signals]:
    """Return the signals of x, then of y, in a part of the image."""
    shown = dict(folded.alike(part, folded.plan.fringe_frames))
    return signals_of(folded, lambda image: image[part], shown.__getitem__)


def _stack(images: Sequence[NDArray[Any]], shape: tuple[int, int]) -> Floats32:
    """Stack images of one shape to (images, P)."""
    stack = np.empty((len(images), *shape), np.float32)
    for row, image in zip(stack, images, strict=True):
        row[:] = image
    return stack.reshape(len(images), shape[0] * shape[1])
