"""Decode one projector coordinate from code words and fringe components: coordinate, variance, mask reason."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats32, Image, Words, compiled
from scanner.decoding.codes import Interval, interval_of
from scanner.decoding.coordinates.code_images import Signals
from scanner.decoding.fringes import (
    Orders,
    Tolerances,
    Unchecked,
    Wrapped,
    correct_systematic,
    log_amplitude,
    resolve_contradictory_codes,
    unwrap,
)
from scanner.decoding.light import NoiseModel
from scanner.decoding.mask_reasons import (
    NOT_LIT,
    UNCERTAIN,
    MaskReason,
    PixelFlags,
    Reasons,
    flag_contrast,
    flag_inverted_bits,
    flag_light,
    reasons_of,
)
from scanner.decoding.sequence_plan import AxisPlan, Fringe, GrayCode
from scanner.decoding.significance import OUTLYING_SIGMAS, SIGNIFICANT_SIGMAS

# One-sided 93 %. A bit this weak lies at the edge of its stripe, where a wrong one costs a single cell.
_CERTAIN_BIT = 1.5
# Noise may carry a coordinate this far beyond the projector's pixels.
EDGE_PX = 0.5
# Coefficients of odd powers.
_ARCTAN_1, _ARCTAN_3, _ARCTAN_5, _ARCTAN_7 = (
    np.float32(c) for c in (0.9997878412794807, -0.3258083974640975, 0.1555786518463281, -0.04432655554792128)
)
_QUARTER_TURN, _HALF_TURN, _WHOLE_TURN = (np.float32(angle) for angle in (pi / 2, pi, 2 * pi))
_FAINTEST, _ZERO = np.float32(1e-6), np.float32(0)

_BLOCK = 2048  # pixels whose components stay in the nearest cache

# Variance at black, and per grey level.
Unit = tuple[np.float32, np.float32]


@dataclass(frozen=True)
class Coordinate:
    """One projector coordinate of all pixels (H, W)."""

    value: Floats32
    """In projector pixels."""
    variance: Floats32
    """Of the value."""
    reason: Reasons
    """For masking the pixel, a `MaskReason`."""
    log_amplitude: Floats32 | None = None
    """Of the finest resolved fringes; None without fringes."""


@dataclass(frozen=True)
class UnwrappedFringes:
    """Code interval and unwrapped fringes of one axis at P pixels."""

    interval: Interval
    """By the codes."""
    level: Floats32
    """(P,): as `Signals.threshold`."""
    units_px2: Sequence[Unit]
    """Per fringe, the variance of its coordinate at an amplitude of 1: at black, and per grey level."""
    variances: Floats32
    """(fringes, P): of the coordinates, from noise."""
    orders: Orders
    """The coordinates by each fringe."""
    flags: Reasons
    """(P,): of `PixelFlags`."""

    def power(self, number: int) -> Floats32:
        """Return the squared amplitude of a fringe, (P,), recovered from its variance."""
        power = np.empty_like(self.level)
        _divide(self.level, *self.units_px2[number], self.variances[number], power)
        return power

    @property
    def well_lit(self) -> Bools:
        """(P,): the longest fringe is seen, and no fringe is saturated."""
        lit: Bools = self.flags & np.uint8(NOT_LIT) == 0
        return lit

    @property
    def certain(self) -> Bools:
        """(P,): well lit, with a fringe order that is consistent and unique."""
        certain: Bools = self.flags & np.uint8(NOT_LIT | UNCERTAIN) == 0
        return certain


@dataclass(frozen=True)
class GrayAxis:
    """Decodes the words of one axis into a coordinate: the middle of the cells that they leave."""

    plan: AxisPlan
    """What measures the axis."""
    noise: NoiseModel
    """Of a pixel."""

    def decode(self, signals: Signals) -> Coordinate:
        """Return the coordinate at every pixel."""
        least_certain, least_seen = least_contrasts(self.noise, signals.threshold)
        undecided = {
            number: _undecided(code, fine, least_certain)
            for number, (code, fine) in enumerate(zip(self.plan.codes, signals.fine, strict=True))
            if fine
        }
        interval = interval_of(self.plan, signals.words, len(signals.threshold), undecided)
        for least, contrast in zip(signals.least, signals.contrast, strict=True):
            flag_contrast(least, least_certain, contrast, least_seen, interval.flags)
        variance, reason = interval.variance(self.plan.cell), reasons_of(interval.flags)
        shape = signals.shape
        return Coordinate(interval.centre.reshape(shape), variance.reshape(shape), reason.reshape(shape))


@dataclass(frozen=True)
class FringeAxis:
    """Decodes the fringes of one axis into a coordinate, with the words of its codes if there are any."""

    plan: AxisPlan
    """What measures the axis."""
    noise: NoiseModel
    """Of a pixel."""
    saturation: float
    """The lowest clipped grey level."""
    ripple: tuple[Floats32 | None, ...]
    """Per fringe, a correction table of its phase over one cycle, or None."""
    tolerances: Tolerances
    """Of codes and fringes with each other."""
    finest: int = 0
    """Index of the shortest fringe that is resolved."""
    blurred: float = 1.0
    """Factor by which lens blur weakens the longest fringe."""
    unchecked: Unchecked | None = None
    """Systematic error of an axis with a single fringe, which nothing in the capture checks; None otherwise."""

    @cached_property
    def _units_px2(self) -> list[Unit]:
        """As in `UnwrappedFringes`: σ = (λ/2π) · gain · σ_I / amplitude, where the gain is √(2/N) for N equal
        shifts.
        """
        units = [(fringe.period / (2 * pi) * fringe.noise_gain) ** 2 for fringe in self.plan.fringes]
        return [(np.float32(unit * self.noise.at_black), np.float32(unit * self.noise.gain)) for unit in units]

    @cached_property
    def _darkest_px2(self) -> np.float32:
        """The variance of the longest fringe at the limit of detection; blur affects the others more."""
        return np.float32(largest_variance(self.plan.fringes[0], with_gray=bool(self.plan.codes)))

    def measure(self, signals: Signals) -> UnwrappedFringes:
        """Unwrap the fringes at every pixel."""
        interval = interval_of(self.plan, signals.words, len(signals.threshold))
        wrapped = self.wrapped(signals)
        orders = unwrap(self.plan, interval, wrapped, self.tolerances)
        if self.plan.corrects_bits:
            resolve_contradictory_codes(self.plan, signals.words, wrapped, self.tolerances, interval, orders)
        variances, flags = wrapped.variances, interval.flags | orders.flags
        del wrapped
        at_black, per_level = (np.float32(self.blurred**2) * unit for unit in self._units_px2[0])
        light = variances[0], at_black, per_level, signals.white, signals.threshold
        flag_light(*light, signals.peak, self._darkest_px2, np.float32(self.saturation), flags)
        if self.blurred > 1:
            flags[self._faintly_seen(variances[0], signals)] &= np.uint8(~PixelFlags.DARK & 255)
        # Without a second period, nothing contradicts a bit that interreflection has inverted.
        for least in () if self.plan.corrects_bits else signals.least:
            flag_inverted_bits(*light, least, flags)
        return UnwrappedFringes(interval, signals.threshold, self._units_px2, variances, orders, flags)

    def wrapped(self, signals: Signals) -> Wrapped:
        """Return each fringe's position within its period, and its variance."""
        shape = len(self.plan.fringes), len(signals.threshold)
        positions, variances = (np.empty(shape, np.float32) for _ in range(2))
        for k, (fringe, ripple) in enumerate(zip(self.plan.fringes, self.ripple, strict=True)):
            px_per_radian = np.float32(fringe.period / (2 * pi))
            (levels, weights), noise = signals.steps[k], (signals.threshold, *self._units_px2[k])
            _measure(levels, weights, *noise, px_per_radian, variances[k], positions[k])
            if ripple is not None:
                _straighten(positions[k], px_per_radian * ripple, np.float32(len(ripple) / fringe.period))
        return Wrapped(positions, variances)

    def _faintly_seen(self, variance: Floats32, signals: Signals) -> Bools:
        """(P,): stripes are resolved, and the longest fringe is a little above the noise."""
        _, least_seen = least_contrasts(self.noise, signals.threshold)
        lit = 2 * (signals.white - signals.threshold) > least_seen
        # The stripes show that the pixel is lit, so that fewer standard deviations suffice.
        visible: Bools = lit & (variance <= np.float32((SIGNIFICANT_SIGMAS / OUTLYING_SIGMAS) ** 2) * self._darkest_px2)
        return visible

    def decode(self, signals: Signals) -> Coordinate:
        """Return the coordinate at every pixel."""
        measured = self.measure(signals)
        coordinates, variances = measured.orders.coordinates, measured.variances
        reason, power, usable = reasons_of(measured.flags), measured.power(self.finest), measured.certain
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
        value, variance = coordinates[0], variances[0]
        for of_fringe, own_variance in zip(coordinates[1:], variances[1:], strict=True):
            _average_in(of_fringe, own_variance, value, variance)
        mask_outside(self.plan, value, reason)
        if signals.log_exposure is not None:
            brightness -= signals.log_exposure
        shape = signals.shape
        return Coordinate(
            value.reshape(shape), variance.reshape(shape), reason.reshape(shape), brightness.reshape(shape)
        )


AxisDecoder = GrayAxis | FringeAxis


def _undecided(code: GrayCode, fine: Mapping[int, Image], least_certain: Floats32) -> Words:
    """Return the bits (P,) of a code's words whose contrast (P,) is too small to decide them."""
    words = np.zeros(len(least_certain), np.uint32)
    for bit, contrast in fine.items():
        words |= (contrast <= least_certain).astype(np.uint32) << np.uint32(code.bits - 1 - bit)
    return words


def least_contrasts(noise: NoiseModel, threshold: NDArray[np.generic]) -> tuple[Floats32, Floats32]:
    """Return the least contrast of a certain bit, and of a visible code, at each grey level half-way between lit and
    unlit.
    """
    difference_sigma = np.float32(sqrt(2)) * noise.sigma(threshold)
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
def _measure(
    levels: Image,
    weights: Floats32,
    level: Floats32,
    at_black: np.float32,
    per_level: np.float32,
    px_per_radian: np.float32,
    variance: Floats32,
    position: Floats32,
) -> None:
    """Compute a fringe's position (P,) within its period from the levels of its frames (N, P), and its variance (P,)
    from noise that grows with the grey level.

    The `weights` (2, N) give its components. The polynomial gives the arc tangent of 0 to 1 to 1.7e-4 (that of
    `cv2.phase`).
    """
    components = np.empty((2, _BLOCK), np.float32)
    for start in range(0, len(level), _BLOCK):
        stop = min(start + _BLOCK, len(level))
        components[:] = _ZERO
        for frame in range(len(levels)):
            of_frame = levels[frame, start:stop]
            for component in range(2):
                weight, into = weights[component, frame], components[component]
                if weight != _ZERO:
                    for i in range(len(of_frame)):
                        into[i] += weight * np.float32(of_frame[i])
        of_cosine, of_sine = components[0], components[1]
        of_level, of_variance, of_position = level[start:stop], variance[start:stop], position[start:stop]
        for i in range(len(of_level)):
            across, up = of_cosine[i], of_sine[i]
            of_variance[i] = (at_black + per_level * of_level[i]) / max(across * across + up * up, _FAINTEST)
            larger, smaller = max(abs(across), abs(up)), min(abs(across), abs(up))
            ratio = smaller / max(larger, _FAINTEST)
            square = ratio * ratio
            angle = (((_ARCTAN_7 * square + _ARCTAN_5) * square + _ARCTAN_3) * square + _ARCTAN_1) * ratio
            angle = _QUARTER_TURN - angle if abs(up) > abs(across) else angle
            angle = _HALF_TURN - angle if across < _ZERO else angle
            of_position[i] = px_per_radian * (_WHOLE_TURN - angle if up < _ZERO else angle)


@compiled
def _straighten(position: Floats32, ripple: Floats32, steps_per_px: np.float32) -> None:
    """Add a correction table over one period, whose length is a power of two, to the positions (P,)."""
    last = np.int32(len(ripple) - 1)
    for i in range(len(position)):
        position[i] += ripple[np.int32(position[i] * steps_per_px) & last]


@compiled
def _divide(level: Floats32, at_black: np.float32, per_level: np.float32, variance: Floats32, power: Floats32) -> None:
    """Divide the variance at an amplitude of 1 by the actual one; (P,)."""
    for i in range(len(power)):
        power[i] = (at_black + per_level * level[i]) / variance[i]


@compiled
def _average_in(coordinate: Floats32, own_variance: Floats32, value: Floats32, variance: Floats32) -> None:
    """Update `value` and `variance` to the inverse-variance weighted mean with another coordinate, in place."""
    for i in range(len(value)):
        share = variance[i] / (variance[i] + own_variance[i])
        value[i] += share * (coordinate[i] - value[i])
        variance[i] = share * own_variance[i]


def mask_outside(axis: AxisPlan, value: Floats32, reason: Reasons) -> None:
    """Mask the unmasked ones of the coordinates (P,) that are beyond the picture's border, in place."""
    centre, reach = np.float32((axis.length - 1) / 2), np.float32(axis.length / 2 + EDGE_PX)
    _note_beyond(value, centre, reach, np.uint8(MaskReason.OUTSIDE), reason)


@compiled
def _note_beyond(value: Floats32, centre: np.float32, reach: np.float32, outside: np.uint8, reason: Reasons) -> None:
    """Set the reason `outside` at unmasked pixels that are farther than `reach` from the centre."""
    for i in range(len(value)):
        reason[i] = outside if (abs(value[i] - centre) > reach) & (reason[i] == 0) else reason[i]
