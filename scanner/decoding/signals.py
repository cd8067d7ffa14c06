"""What was accumulated, for one axis at some pixels, in the form in which it is decoded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Image
from scanner.decoding.accumulate import Accumulators
from scanner.decoding.arrays import Floats32, Words
from scanner.decoding.plan import AxisPlan


@dataclass(frozen=True)
class Signals:
    """One axis at P pixels, which make up an image of `shape` (H, W), row after row.

    `words`: per code, (P,). `least` (codes, P) unless fringes contradict wrong bits, and `contrast` (codes, P)
    without fringes, as in `GrayFold`; else with no codes. `components` (fringes, 2, P): longest period first.
    `brightest`, `middle` (P,): grey level when lit, and half-way between lit and unlit. `peak` (P,): largest among the
    fringes. `log_exposure` (P,): None if all pixels have the same.
    """

    shape: tuple[int, int]
    words: list[Words]
    least: Floats32
    contrast: Floats32
    components: Floats32
    brightest: Floats32
    middle: Floats32
    peak: Image
    log_exposure: Floats32 | None = None


def signals_of(accumulators: Accumulators, select: Callable[[NDArray[Any]], NDArray[Any]]) -> tuple[Signals, Signals]:
    """The accumulated signals of x and y at some pixels; `select` takes these from an (H, W) image, as a 2-D array."""
    middle, peak, log_exposure = select(accumulators.middle), select(accumulators.peak), accumulators.log_exposure
    shape = middle.shape[0], middle.shape[1]
    brightest, half_lit = _stack([select(accumulators.brightest), middle], shape)
    exposure = None if log_exposure is None else select(log_exposure).reshape(-1)

    def of_axis(axis: AxisPlan) -> Signals:
        codes = [fold for fold in accumulators.codes if fold.code in axis.codes]
        fringes = [fold for fold in accumulators.fringes if fold.fringe in axis.fringes]
        components = np.empty((len(fringes), 2, *shape), np.float32)
        for of_fringe, fold in zip(components, fringes, strict=True):
            for levels, component in zip(of_fringe, (fold.cosine, fold.sine), strict=True):
                np.multiply(select(component), np.float32(fold.scale), out=levels)
        return Signals(
            shape,
            [select(fold.words).reshape(-1) for fold in codes],
            _stack([] if axis.corrects_bits else [select(fold.least) for fold in codes], shape),
            _stack([select(fold.contrast) for fold in codes if fold.contrast is not None], shape),
            components.reshape(len(fringes), 2, middle.size),
            brightest,
            half_lit,
            peak.reshape(-1),
            exposure,
        )

    return of_axis(accumulators.plan.x), of_axis(accumulators.plan.y)


def _stack(images: Sequence[NDArray[Any]], shape: tuple[int, int]) -> Floats32:
    """Images of one shape, (images, P)."""
    stack = np.empty((len(images), *shape), np.float32)
    for row, image in zip(stack, images, strict=True):
        row[:] = image
    return stack.reshape(len(images), shape[0] * shape[1])
