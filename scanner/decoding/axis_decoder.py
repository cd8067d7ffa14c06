"""Decode one projector coordinate from code words and fringe components: coordinate, variance, mask reason."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from math import pi, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Image, compiled
from scanner.decoding.arrays import NEGLIGIBLE, Floats32, Reasons, Words
from scanner.decoding.axis_signals import Signals
from scanner.decoding.codes.gray_code import Interval, interval_of
from scanner.decoding.fringes.code_voting import resolve_contradictory_codes
from scanner.decoding.fringes.edge_shift_correction import log_amplitude
from scanner.decoding.fringes.phase_unwrapping import Orders, Tolerances, Wrapped, unwrap
from scanner.decoding.fringes.single_fringe import Unchecked
from scanner.decoding.fringes.systematic_error import correct_systematic
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.mask_reasons import (
    NOT_LIT,
    UNCERTAIN,
    Against,
    MaskReason,
    note_codes,
    note_contrast,
    note_indirect,
    note_inverted_bits,
    note_light,
    note_orders,
    reasons_of,
)
from scanner.decoding.sequence_plan import AxisPlan, Fringe, GrayCode
from scanner.decoding.significance import OUTLYING_SIGMAS, SIGNIFICANT_SIGMAS

# One-sided 93 %. A bit this weak lies at the edge of its stripe, where a wrong one costs a single cell.
_CERTAIN_BIT = 1.5
# Noise may carry a coordinate this far beyond the projector's pixels.
EDGE_PX = 0.5


@dataclass(frozen=True)
class Coordinate:
    """`value` in projector pixels with its `variance`, and the `reason` for masking it; arrays (H, W).

    `log_amplitude`: of the finest resolved fringes; None without fringes.
    """

    value: Floats32
    variance: Floats32
    reason: Reasons
    log_amplitude: Floats32 | None = None


@dataclass(frozen=True)
class Measured:
    """Code interval and unwrapped fringes of one axis at P pixels.

    `variances` (fringes, P): of the coordinates, from noise. `against` (P,): flags of `Against`. `units_px2`: maps a
    fringe's number to the variance (P,) of its coordinate at an amplitude of 1.
    """

    interval: Interval
    units_px2: Callable[[int], Floats32]
    variances: Floats32
    orders: Orders
    against: Reasons

    def power(self, number: int) -> Floats32:
        """Return the squared amplitude of a fringe, (P,), recovered from its variance."""
        power = self.units_px2(number)
        power /= self.variances[number]
        return power

    @property
    def well_lit(self) -> Bools:
        """(P,): the longest fringe is seen, and no fringe is saturated."""
        lit: Bools = self.against & np.uint8(NOT_LIT) == 0
        return lit

    @property
    def certain(self) -> Bools:
        """(P,): well lit, with a fringe order that is consistent and unique."""
        certain: Bools = self.against & np.uint8(NOT_LIT | UNCERTAIN) == 0
        return certain


@dataclass(frozen=True)
class AxisDecoder:
    """Decodes the signals of one axis into a coordinate.

    `ripple`: per fringe, a correction table of its phase over one cycle, or None. `finest`: index of the shortest
    fringe that is resolved. `blurred`: factor by which lens blur weakens the longest fringe. `unchecked`: systematic
    error of an axis with a single fringe, which nothing in the capture checks; None otherwise.
    """

    plan: AxisPlan
    noise: NoiseModel
    saturation: float
    ripple: tuple[Floats32 | None, ...]
    tolerances: Tolerances
    finest: int = 0
    blurred: float = 1.0
    unchecked: Unchecked | None = None

    @cached_property
    def _units_px2(self) -> list[float]:
        """Per fringe, the variance of its coordinate where noise and amplitude are equal.

        σ = (λ/2π) · gain · σ_I / amplitude, where the gain is √(2/N) for N equal shifts.
        """
        return [(fringe.period / (2 * pi) * fringe.noise_gain) ** 2 for fringe in self.plan.fringes]

    @cached_property
    def _darkest_px2(self) -> np.float32:
        """The variance of the longest fringe at the limit of detection; blur affects the others more."""
        return np.float32(largest_variance(self.plan.fringes[0], with_gray=bool(self.plan.codes)))

    def decode(self, signals: Signals) -> Coordinate:
        """Return the coordinate at every pixel."""
        return self._from_fringes(signals) if self.plan.fringes else self._from_codes(signals)

    def measure(self, signals: Signals) -> Measured:
        """Unwrap the fringes at every pixel; for an axis with fringes."""
        interval = interval_of(self.plan, signals.words, len(signals.middle))
        shape = len(self.plan.fringes), len(signals.middle)
        variances, positions = (np.empty(shape, np.float32) for _ in range(2))
        for k, unit in enumerate(self._units_px2):
            cosine, sine = signals.fringe(k)
            at_black, per_level = np.float32(unit * self.noise.at_black), np.float32(unit * self.noise.gain)
            _variance(cosine, sine, signals.middle, at_black, per_level, np.float32(NEGLIGIBLE), variances[k])
            self._position(k, cosine, sine, positions[k])
            del cosine, sine
        wrapped = Wrapped(positions, variances)
        orders = unwrap(self.plan, interval, wrapped, self.tolerances, in_place=not self.plan.corrects_bits)
        if self.plan.corrects_bits:
            resolve_contradictory_codes(self.plan, signals.words, wrapped, self.tolerances, interval, orders)
        del wrapped, positions
        against = np.empty(len(signals.middle), np.uint8)
        note_codes(interval.outside, interval.contradictory, against)
        note_orders(orders.agree, orders.unique, against)
        measured = Measured(interval, partial(self._unit_px2, signals.middle), variances, orders, against)
        direct = measured.power(0)
        direct *= np.float32(self.blurred**2)
        note_indirect(direct, signals.brightest, signals.middle, against)
        note_light(variances[0], self._darkest_px2, self._saturated(signals), against)
        if self.blurred > 1:
            against[self._faintly_seen(variances[0], signals)] &= np.uint8(~Against.DARK & 255)
        # Without a second period, nothing contradicts a bit that interreflection has inverted.
        for least in () if self.plan.corrects_bits else signals.least:
            note_inverted_bits(least, direct, signals.brightest, signals.middle, against)
        return measured

    def _unit_px2(self, level: Floats32, number: int) -> Floats32:
        """Return the variance of a fringe's coordinate at amplitude 1, from the noise at each grey level (P,)."""
        unit = self._units_px2[number]
        return np.float32(unit * self.noise.at_black) + np.float32(unit * self.noise.gain) * level

    def positions(self, signals: Signals) -> Floats32:
        """Return each fringe's position within its period, in projector pixels, (fringes, P)."""
        found = np.empty((len(self.plan.fringes), len(signals.middle)), np.float32)
        for k, position in enumerate(found):
            self._position(k, *signals.fringe(k), position)
        return found

    def _position(self, number: int, cosine: Floats32, sine: Floats32, position: Floats32) -> None:
        cv2.phase(cosine[None], sine[None], position[None])
        ripple = self.ripple[number]
        if ripple is not None:
            _straighten(position, ripple)
        position *= np.float32(self.plan.fringes[number].period / (2 * pi))

    def _faintly_seen(self, variance: Floats32, signals: Signals) -> Bools:
        """(P,): stripes are resolved, and the longest fringe is a little above the noise."""
        _, least_seen = least_contrasts(self.noise, signals.middle)
        lit = 2 * (signals.brightest - signals.middle) > least_seen
        # The stripes show that the pixel is lit, so that fewer standard deviations suffice.
        seen: Bools = lit & (variance <= np.float32((SIGNIFICANT_SIGMAS / OUTLYING_SIGMAS) ** 2) * self._darkest_px2)
        return seen

    def _saturated(self, signals: Signals) -> Bools:
        # Compare in the image's own type: comparing bytes with a float would convert all of them.
        peak = signals.peak
        if self.saturation > np.iinfo(peak.dtype).max:
            return np.zeros(peak.shape, np.bool_)
        saturated: Bools = peak >= peak.dtype.type(self.saturation)
        return saturated

    def _from_fringes(self, signals: Signals) -> Coordinate:
        measured = self.measure(signals)
        coordinates, variances = measured.orders.coordinates, measured.variances
        reason, power, usable = reasons_of(measured.against), measured.power(self.finest), measured.certain
        del measured  # frees a quarter of the memory for decoding a tile
        brightness = log_amplitude(power)
        del power
        if len(coordinates) > 1:
            for fringe, variance in zip(self.plan.fringes, variances, strict=True):
                usable &= variance <= np.float32(largest_variance(fringe))
            periods = [fringe.period for fringe in self.plan.fringes]
            correct_systematic(periods, coordinates, variances, usable, signals.shape)
        elif self.unchecked is not None:
            self.unchecked.add_to(variances[0], coordinates[0])
        value, variance = coordinates[0].copy(), variances[0].copy()
        for of_fringe, own_variance in zip(coordinates[1:], variances[1:], strict=True):
            _average_in(of_fringe, own_variance, value, variance)
        centre, reach = np.float32((self.plan.length - 1) / 2), np.float32(self.plan.length / 2 + EDGE_PX)
        _note_beyond(value, centre, reach, np.uint8(MaskReason.OUTSIDE), reason)
        if signals.log_exposure is not None:
            brightness -= signals.log_exposure
        shape = signals.shape
        return Coordinate(
            value.reshape(shape), variance.reshape(shape), reason.reshape(shape), brightness.reshape(shape)
        )

    def _from_codes(self, signals: Signals) -> Coordinate:
        least_certain, least_seen = least_contrasts(self.noise, signals.middle)
        undecided = {
            number: _undecided(code, fine, least_certain)
            for number, (code, fine) in enumerate(zip(self.plan.codes, signals.fine, strict=True))
            if fine
        }
        interval = interval_of(self.plan, signals.words, len(signals.middle), undecided)
        against = np.empty(len(signals.middle), np.uint8)
        note_codes(interval.outside, interval.contradictory, against)
        for least, contrast in zip(signals.least, signals.contrast, strict=True):
            note_contrast(least, least_certain, contrast, least_seen, against)
        variance = interval.variance(self.plan.cell)
        shape = signals.shape
        return Coordinate(interval.centre.reshape(shape), variance.reshape(shape), reasons_of(against).reshape(shape))


def _undecided(code: GrayCode, fine: Mapping[int, Image], least_certain: Floats32) -> Words:
    """Return the bits (P,) of a code's words whose contrast (P,) is too small to decide them."""
    words = np.zeros(len(least_certain), np.uint32)
    for bit, contrast in fine.items():
        words |= (contrast <= least_certain).astype(np.uint32) << np.uint32(code.bits - 1 - bit)
    return words


def least_contrasts(noise: NoiseModel, middle: NDArray[np.generic]) -> tuple[Floats32, Floats32]:
    """Return the least contrast of a certain bit, and of a visible code, at each grey level half-way between lit and
    unlit.
    """
    difference_sigma = np.float32(sqrt(2)) * noise.sigma(middle)
    certain = np.maximum(np.float32(noise.stray), np.float32(_CERTAIN_BIT) * difference_sigma)
    return certain, np.maximum(np.float32(2 * noise.stray), np.float32(SIGNIFICANT_SIGMAS) * difference_sigma)


def largest_variance(fringe: Fringe, *, with_gray: bool = False) -> float:
    """Return the variance of a fringe at the limit of detection.

    With a Gray code the single bits must be seen too: they have √2 of a frame's noise, and a contrast of twice the
    fringe's amplitude.
    """
    needed = (
        max(SIGNIFICANT_SIGMAS, SIGNIFICANT_SIGMAS / sqrt(2) / fringe.noise_gain) if with_gray else SIGNIFICANT_SIGMAS
    )
    return (fringe.period / (2 * pi) / needed) ** 2


@compiled
def _variance(
    cosine: Floats32,
    sine: Floats32,
    level: Floats32,
    at_black: np.float32,
    per_level: np.float32,
    faintest: np.float32,
    variance: Floats32,
) -> None:
    """Compute the variance (P,) of a fringe's coordinate from noise that grows with the grey level."""
    for i in range(len(cosine)):
        power = max(cosine[i] * cosine[i] + sine[i] * sine[i], faintest)
        variance[i] = (at_black + per_level * level[i]) / power


@compiled
def _straighten(phase: Floats32, ripple: Floats32) -> None:
    """Add a correction table over one cycle, whose length is a power of two, to the phase (P,)."""
    last, steps_per_radian = np.int32(len(ripple) - 1), np.float32(len(ripple) / (2 * pi))
    for i in range(len(phase)):
        phase[i] += ripple[np.int32(phase[i] * steps_per_radian) & last]


@compiled
def _average_in(coordinate: Floats32, own_variance: Floats32, value: Floats32, variance: Floats32) -> None:
    """Update `value` and `variance` to the inverse-variance weighted mean with another coordinate, in place."""
    for i in range(len(value)):
        share = variance[i] / (variance[i] + own_variance[i])
        value[i] += share * (coordinate[i] - value[i])
        variance[i] = share * own_variance[i]


@compiled
def _note_beyond(value: Floats32, centre: np.float32, reach: np.float32, outside: np.uint8, reason: Reasons) -> None:
    """Set the reason `outside` at unmasked pixels that are farther than `reach` from the centre."""
    for i in range(len(value)):
        reason[i] = outside if (abs(value[i] - centre) > reach) & (reason[i] == 0) else reason[i]
