"""One projector coordinate from what was accumulated: code words, fringe components → coordinate, variance, reason."""

from dataclasses import dataclass
from enum import IntEnum
from math import pi, sqrt
from typing import cast

import cv2
import numpy as np

from calib.arrays import Bools, Image
from scanner.decoding.arrays import Floats32, Reasons, Words
from scanner.decoding.codes import Interval, interval_of
from scanner.decoding.noise import NoiseModel
from scanner.decoding.plan import AxisPlan, Fringe
from scanner.decoding.response import TABLE_LENGTH
from scanner.decoding.shading import log_amplitude
from scanner.decoding.systematic import systematic_variances
from scanner.decoding.unwrap import Orders, Tolerances, Wrapped, unwrap

# A signal counts from five standard deviations on: an unlit pixel passes by chance once in three million times.
_SEEN = 5.0
# One-sided 93 %. A bit this weak lies at the edge of its stripe, where a wrong one costs a single cell.
_CERTAIN_BIT = 1.5
# Smaller differences are rounding, compression and stray light, whatever the noise.
_LEAST_DIFFERENCE = 5.0
# How far beyond the projector's pixels noise may carry a coordinate.
_EDGE_PX = 0.5


class MaskReason(IntEnum):
    """Why a camera pixel has no match."""

    KEPT = 0
    DARK = 1
    """The patterns change its brightness by no more than noise would."""
    SATURATED = 2
    """A fringe reached the camera's largest value."""
    UNDECIDED = 3
    """A bit of the Gray code is within the noise of its threshold, and no fringe helps."""
    INCONSISTENT = 4
    """Gray codes and fringes contradict each other, or allow two answers."""
    OUTSIDE = 5
    """The code is that of no projector pixel."""
    ISOLATED = 6
    """It does not continue the surface that its neighbours see: an edge of surface or light, or a lone error."""
    INDIRECT = 7
    """Codes and fringes contradict each other where more light comes from other surfaces than from the projector."""


@dataclass(frozen=True)
class Signals:
    """What was accumulated for one axis at some pixels; all arrays of one 2-D shape.

    Per code `words`, `least` unless fringes contradict wrong bits, and, without fringes, `contrast` as in `GrayFold`;
    per fringe its two components, longest period first.
    `brightest`, `middle`: grey level when lit, and half-way between lit and unlit. `peak`: largest among the fringes.
    `log_exposure`: None if all pixels have the same.
    """

    words: list[Words]
    least: list[Image]
    contrast: list[Image]
    fringes: list[tuple[Floats32, Floats32]]
    brightest: Image
    middle: Image
    peak: Image
    log_exposure: Floats32 | None = None


@dataclass(frozen=True)
class Coordinate:
    """`value` in projector pixels with its `variance`, and the `reason` not to use it; arrays of one shape.

    `log_amplitude`: of the finest fringes that are seen; None without fringes.
    """

    value: Floats32
    variance: Floats32
    reason: Reasons
    log_amplitude: Floats32 | None = None


@dataclass(frozen=True)
class AxisDecoder:
    """Turns signals into one coordinate.

    `ripple`: per fringe, what to add to its phase (a table over a cycle), or None. `finest`: the number of the shortest
    fringe that is seen where there is light.
    """

    plan: AxisPlan
    noise: NoiseModel
    saturation: float
    ripple: tuple[Floats32 | None, ...]
    tolerances: Tolerances
    finest: int = 0

    def decode(self, signals: Signals) -> Coordinate:
        """The coordinate at every pixel of the signals."""
        interval = interval_of(self.plan, signals.words)
        decode = self._from_fringes if self.plan.fringes else self._from_codes
        coordinate = decode(signals, interval)
        reason = coordinate.reason
        if interval.contradictory.any():
            reason[(reason == MaskReason.KEPT) & interval.contradictory] = MaskReason.INCONSISTENT
        if interval.outside.any():
            undecided = (reason == MaskReason.KEPT) | (reason == MaskReason.INCONSISTENT)
            reason[undecided & interval.outside] = MaskReason.OUTSIDE
        return coordinate

    def well_lit(self, signals: Signals) -> Bools:
        """Where the longest fringe is seen and none is saturated."""
        return ~(self._dark(self.fringe_variances(signals)) | self._saturated(signals.peak))

    def seen(self, variances: list[Floats32]) -> Bools:
        """Where every fringe is seen, given the variances of their coordinates."""
        seen = [v <= largest_variance(f) for f, v in zip(self.plan.fringes, variances, strict=True)]
        result: Bools = np.all(seen, axis=0)
        return result

    def positions(self, signals: Signals) -> list[Floats32]:
        """Per fringe, the position within its period in projector pixels."""
        found = []
        for fringe, ripple, components in zip(self.plan.fringes, self.ripple, signals.fringes, strict=True):
            phase = cast(Floats32, cv2.phase(*components))
            if ripple is not None:
                index = phase * np.float32(TABLE_LENGTH / (2 * pi))
                phase += np.take(ripple, index.astype(np.uint16), mode="wrap")
            phase *= np.float32(fringe.period / (2 * pi))
            found.append(phase)
        return found

    def orders(self, signals: Signals, interval: Interval, variances: list[Floats32]) -> Orders:
        """The fringe orders at every pixel, certain or not."""
        wrapped = [Wrapped(*pair) for pair in zip(self.positions(signals), variances, strict=True)]
        return unwrap(self.plan, interval, wrapped, self.tolerances)

    def fringe_variances(self, signals: Signals) -> list[Floats32]:
        """Per fringe, the variance of its coordinate by noise.

        σ = (λ/2π) · gain · σ_I / amplitude, where the gain is √(2/N) for N equal shifts.
        """
        return self._variances(_powers(signals), signals)

    def _variances(self, powers: list[Floats32], signals: Signals) -> list[Floats32]:
        level_variance = self.noise.variance(signals.middle)
        variances = []
        for fringe, power in zip(self.plan.fringes, powers, strict=True):
            variance = level_variance / power
            variance *= np.float32((fringe.period / (2 * pi) * fringe.noise_gain) ** 2)
            variances.append(variance)
        return variances

    def _dark(self, variances: list[Floats32]) -> Bools:
        """Where the longest fringe is not seen; the lenses blur the others more, and they are not needed."""
        dark: Bools = variances[0] > largest_variance(self.plan.fringes[0], with_gray=bool(self.plan.codes))
        return dark

    def _saturated(self, level: Image) -> Bools:
        # In the image's own type, for comparing bytes with a float converts them all.
        if self.saturation > np.iinfo(level.dtype).max:
            return np.zeros(level.shape, np.bool_)
        saturated: Bools = level >= level.dtype.type(self.saturation)
        return saturated

    def _from_fringes(self, signals: Signals, interval: Interval) -> Coordinate:
        powers = _powers(signals)
        variances = self._variances(powers, signals)
        orders = self.orders(signals, interval, variances)
        certain = orders.certain
        dark = self._dark(variances)
        bright = self._saturated(signals.peak)
        periods = [fringe.period for fringe in self.plan.fringes]
        if len(periods) > 1:
            usable = certain & self.seen(variances) & ~dark & ~bright
            systematic = systematic_variances(periods, orders.coordinates, variances, usable)
            for variance, more in zip(variances, systematic, strict=True):
                variance += more
        value, variance = _weighted_mean(orders.coordinates, variances)
        reason = np.zeros(value.shape, np.uint8)
        centre, reach = np.float32((self.plan.length - 1) / 2), np.float32(self.plan.length / 2 + _EDGE_PX)
        reason[np.abs(value - centre) > reach] = MaskReason.OUTSIDE
        indirect = _mostly_indirect(signals, powers[0])
        reason[~certain] = MaskReason.INCONSISTENT
        reason[~certain & indirect] = MaskReason.INDIRECT
        if not self.plan.corrects_bits:
            # No second period would contradict a bit that global light has turned over.
            reason[_may_be_turned_over(signals, powers[0], indirect)] = MaskReason.INDIRECT
        reason[bright] = MaskReason.SATURATED
        reason[dark] = MaskReason.DARK
        brightness = log_amplitude(powers[self.finest])
        if signals.log_exposure is not None:
            brightness -= signals.log_exposure
        return Coordinate(value, variance, reason, brightness)

    def _from_codes(self, signals: Signals, interval: Interval) -> Coordinate:
        difference_sigma = np.float32(sqrt(2)) * self.noise.sigma(signals.middle)
        least_certain = np.maximum(np.float32(_LEAST_DIFFERENCE), np.float32(_CERTAIN_BIT) * difference_sigma)
        least_seen = np.maximum(np.float32(2 * _LEAST_DIFFERENCE), np.float32(_SEEN) * difference_sigma)
        reason = np.zeros(signals.middle.shape, np.uint8)
        for least, contrast in zip(signals.least, signals.contrast, strict=True):
            reason[(least <= least_certain) & (reason == MaskReason.KEPT)] = MaskReason.UNDECIDED
            reason[contrast <= least_seen] = MaskReason.DARK
        # Evenly spread over the cell: (2 · half)² / 12.
        return Coordinate(interval.centre, np.float32(1 / 3) * interval.half * interval.half, reason)


def _mostly_indirect(signals: Signals, power: Floats32) -> Bools:
    """Where the amplitude of the longest fringe, half of the direct light, is less than a quarter of all light.

    Fringes too short for light to carry them around a corner separate direct from global light (Nayar et al., SIGGRAPH
    2006).
    """
    half_of_all = signals.brightest.astype(np.float32)
    half_of_all -= signals.middle
    half_of_all *= half_of_all
    indirect: Bools = half_of_all > 4 * power
    return indirect


def _may_be_turned_over(signals: Signals, power: Floats32, indirect: Bools) -> Bools:
    """Where a bit's contrast is no more than what global light has in excess of direct light (Xu and Aliaga, 2007)."""
    pixels = np.flatnonzero(indirect)
    brightest, middle = (image.ravel()[pixels].astype(np.float32) for image in (signals.brightest, signals.middle))
    excess = 2 * (brightest - middle) - 4 * np.sqrt(power.ravel()[pixels])
    turned = np.zeros(indirect.shape, np.bool_)
    for least in signals.least:
        turned.ravel()[pixels] |= least.ravel()[pixels] <= excess
    return turned


def _powers(signals: Signals) -> list[Floats32]:
    """Per fringe, the square of its amplitude."""
    powers = []
    for cosine, sine in signals.fringes:
        power = cosine * cosine
        power += sine * sine
        powers.append(np.maximum(power, np.float32(1e-6), out=power))
    return powers


def largest_variance(fringe: Fringe, *, with_gray: bool = False) -> float:
    """The variance of a fringe that is just seen.

    Where a Gray code goes with it, its single bits must be seen too: they have √2 of a frame's noise, and a contrast of
    twice the fringe's amplitude.
    """
    needed = max(_SEEN, _SEEN / sqrt(2) / fringe.noise_gain) if with_gray else _SEEN
    return (fringe.period / (2 * pi) / needed) ** 2


def _weighted_mean(coordinates: list[Floats32], variances: list[Floats32]) -> tuple[Floats32, Floats32]:
    """Each by the inverse of its variance, and the variance of the mean."""
    value, variance = coordinates[0], variances[0]
    for coordinate, own_variance in zip(coordinates[1:], variances[1:], strict=True):
        share = variance / (variance + own_variance)
        value = value + share * (coordinate - value)
        variance = share * own_variance
    return value, variance
