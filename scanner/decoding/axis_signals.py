"""Select the accumulated signals of one axis at given pixels, in the form that the decoder takes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image
from scanner.decoding.accumulators import Accumulators
from scanner.decoding.arrays import Component, Floats32, Words
from scanner.decoding.light.equalise import Correction
from scanner.decoding.sequence_plan import AxisPlan


@dataclass(frozen=True)
class Signals:
    """The signals of one axis at P pixels, which form an image of `shape` (H, W), row by row.

    `words`: per code, (P,). `least` (codes, P): as in `GrayFold`, empty if the fringes correct wrong bits. `contrast`
    (codes, P): as in `GrayFold`, empty with fringes. `fine`: per code, the contrast (P,) of each optional bit, by bit;
    `least` then covers the other bits. `components`: per fringe, longest period first, (P,) each; multiplied by its
    entry in `scales` they are in grey levels, to which `corrections` apply. `brightest`, `middle` (P,): grey level when
    lit, and half-way between lit and unlit. `peak` (P,): maximum over the fringes. `log_exposure` (P,): None if all
    pixels were exposed alike. `rows` (P,): image row; empty if no correction depends on it.
    """

    shape: tuple[int, int]
    words: list[Words]
    least: Floats32
    contrast: Floats32
    fine: list[dict[int, Image]]
    components: list[tuple[Component, Component]]
    scales: list[float]
    corrections: list[Correction | None]
    rows: NDArray[np.int64]
    brightest: Floats32
    middle: Floats32
    peak: Image
    log_exposure: Floats32 | None = None

    def fringe(self, number: int) -> tuple[Floats32, Floats32]:
        """Return the components A cos θ and A sin θ of a fringe in grey levels, (P,) each."""
        scale = np.float32(self.scales[number])
        cosine, sine = (scale * part.astype(np.float32) for part in self.components[number])
        correction = self.corrections[number]
        if correction is None:
            return cosine, sine
        return correction.apply(cosine, sine, self.middle, self.brightest, self.rows)

    def corrected(self, number: int) -> tuple[Component, Component, np.float32]:
        """Return the components of a fringe, (P,) each, and the factor by which they are in grey levels."""
        if self.corrections[number] is None:
            return *self.components[number], np.float32(self.scales[number])
        return *self.fringe(number), np.float32(1)


def signals_of(
    accumulators: Accumulators,
    select: Callable[[NDArray[Any]], NDArray[Any]],
    axes: Sequence[AxisPlan] | None = None,
) -> Iterator[Signals]:
    """Return the signals of x, then of y, or of other `axes`, at the pixels that `select` picks from an (H, W) image,
    as a 2-D array.
    """
    middle, peak, log_exposure = select(accumulators.middle), select(accumulators.peak), accumulators.log_exposure
    shape = middle.shape[0], middle.shape[1]
    brightest, half_lit = _stack([select(accumulators.brightest), middle], shape)
    exposure = None if log_exposure is None else select(log_exposure).reshape(-1)
    rows = np.empty(0, np.int64)
    if any(fold.correction is not None for fold in accumulators.fringes):
        height, width = accumulators.middle.shape
        rows = select(np.broadcast_to(np.arange(height)[:, None], (height, width))).reshape(-1)

    def of_axis(axis: AxisPlan) -> Signals:
        codes = [fold for fold in accumulators.codes if fold.code in axis.codes]
        fringes = [fold for fold in accumulators.fringes if fold.fringe in axis.fringes]
        return Signals(
            shape,
            [select(fold.words).reshape(-1) for fold in codes],
            _stack([] if axis.corrects_bits else [select(fold.least_needed) for fold in codes], shape),
            _stack([select(fold.contrast) for fold in codes if fold.contrast is not None], shape),
            [{bit: select(image).reshape(-1) for bit, image in fold.optional.items()} for fold in codes],
            [(select(fold.cosine).reshape(-1), select(fold.sine).reshape(-1)) for fold in fringes],
            [fold.scale for fold in fringes],
            [fold.correction for fold in fringes],
            rows,
            brightest,
            half_lit,
            np.ascontiguousarray(peak).reshape(-1),
            exposure,
        )

    return map(of_axis, axes or accumulators.plan.axes)


def _stack(images: Sequence[NDArray[Any]], shape: tuple[int, int]) -> Floats32:
    """Stack images of one shape to (images, P)."""
    stack = np.empty((len(images), *shape), np.float32)
    for row, image in zip(stack, images, strict=True):
        row[:] = image
    return stack.reshape(len(images), shape[0] * shape[1])
