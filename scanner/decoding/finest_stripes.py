"""What arrives of the contrast of the finest stripes, along x against along y, at a thin sample of pixels.

Light that bounces, blur and the surface weaken both alike. A projector that resamples its picture does not: where a
pixel of the picture falls between two of the panel, stripes across that direction lose most, and the loss beats over
the picture with the shift between the two (moiré).
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.pixel_sample import Sample
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan

# Of white less black: where less is left of the stripes, noise is most of it.
_LEAST_CONTRAST = 0.02
# Between two stripes a bit says nothing of its contrast.
_LEAST_OF_WAVE = 0.5
_STEPS = 256


@dataclass(frozen=True)
class FinestStripes:
    """At N pixels: `camera_px` (N, 2), `projector_px` (N, 2), `log_ratio` (N,) of the contrast along x to that along y.

    `periods` (2,): of these stripes along x, y, in the picture's pixels.
    """

    camera_px: Floats
    projector_px: Floats
    log_ratio: Floats
    periods: tuple[float, float]


def finest_stripes(plan: SequencePlan, sample: Sample, maps: Maps) -> FinestStripes | None:
    """At the pixels of the sample that are kept. None where an axis has no stripes of which this can be said."""
    kept = maps.reason.reshape(-1)[sample.pixels] == MaskReason.KEPT
    projector_px = maps.projector_px.reshape(-1, 2)[sample.pixels]
    kept &= np.isfinite(projector_px).all(axis=1)
    levels = sample.levels
    of_axes = [_contrast(axis, levels, projector_px[:, number]) for number, axis in enumerate(plan.axes)]
    if any(found is None for found in of_axes) or not kept.any():
        return None
    (x, period_x), (y, period_y) = (found for found in of_axes if found is not None)
    span = np.ptp(levels, axis=0)
    kept &= (np.minimum(x, y) > _LEAST_CONTRAST * np.maximum(span, 1)) & (span > 0)
    row, column = np.divmod(sample.pixels[kept], maps.reason.shape[1])
    ratio = np.log(x[kept]) - np.log(y[kept])
    return FinestStripes(
        np.stack([column, row], axis=1).astype(np.float64),
        projector_px[kept].astype(np.float64),
        ratio.astype(np.float64),
        (period_x, period_y),
    )


def _contrast(axis: AxisPlan, levels: Floats32, coordinate: Floats32) -> tuple[Floats32, float] | None:
    """In grey levels, (P,), 0 where it is unknown; and the period of the stripes that it is of."""
    if axis.fringes:
        fringe = axis.fringes[-1]
        cosine, sine = fringe.weights[1:].astype(np.float32) @ levels[list(fringe.frames)]
        return np.hypot(cosine, sine), fringe.period
    for code in axis.codes:
        bit = max(code.pairs, default=-1)
        if bit == code.bits - 1 and code.base in (None, bit):
            normal, inverse = code.pairs[bit]
            period = 4 * code.cell
            # Of words 0, 1, 2, 3 the finest bit is set in 1 and 2.
            wave = np.cos(2 * np.pi * (coordinate + code.offset + 0.5 - 2 * code.cell) / period)
            known: Bools = np.abs(wave) > _LEAST_OF_WAVE
            contrast = np.where(known, (levels[normal] - levels[inverse]) / np.where(known, wave, 1), 0)
            return np.maximum(contrast, 0).astype(np.float32), float(period)
    return None


def left_between(shift_px: Floats, period: float) -> Floats:
    """The logarithm of what a linear interpolation between two pixels leaves of a wave that is so many pixels long."""
    between = shift_px - np.floor(shift_px)
    left: Floats = 0.5 * np.log(1 - 2 * between * (1 - between) * (1 - np.cos(2 * np.pi / period)))
    return left


def first_harmonic(shift_px: Floats, period: float) -> Floats:
    """The same but for its mean, as smooth as it can be."""
    between = (np.arange(_STEPS) + 0.5) / _STEPS
    half_swing = 2 * np.mean(left_between(between, period) * np.cos(2 * np.pi * between))
    harmonic: Floats = half_swing * np.cos(2 * np.pi * shift_px)
    return harmonic
