"""Estimate the camera's response curve from sums of frames, and linearise frames with it.

A pattern and its inverse add up to the same light as every other pair. Blurred stripes contribute two medium levels,
sharp ones a dark and a bright level, so that a tone curve, as of photographs, makes their sums differ. The inverse
response g = f⁻¹ makes all sums equal, g(I) + g(I') = M at every pixel: least squares in the values of g at a few levels
(radiometric self-calibration, after Mitsunaga and Nayar, CVPR 1999). The rest of the decoder works in the linear light
g(I).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from math import exp, inf
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import TRIAL_PIXELS, Floats, Floats32, Image, Ints, evenly_spread, robust_sigma
from scanner.decoding.light import PartOfFrames, residual_of_gains
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEW, FEWEST_PIXELS, HALF, HUBER_ROUNDS, MAJORITY, NEGLIGIBLE, OUTLYING_SIGMAS
from scanner.patterns import Xor

# Number of levels between which g is linear; weight of its second differences, relative to all pixels, where medium
# levels are of indirect light only (of one pixel elsewhere); weight of the constraints.
_LEVELS, _STIFF, _HELD = 17, 0.1, 10.0
_LINEAR = np.linspace(0, 1, _LEVELS)
# Number of finest bits whose stripes are narrow enough to see many of; number of pixel groups, of which each bit lights
# half the pixels.
_FINE_BITS, _GROUPS = 4, 16
# Squared deviations of the sums, in swings, added up over pairs: below the first two limits they do not matter, and the
# right curve leaves a quarter of them at most, and a tenth of those before. No other cause leaves so little with a
# curve that rises everywhere by this share of its mean slope.
_NOTABLE, _NOTABLE_OF_BITS, _LEFT, _LEAST_SLOPE = 0.006, 0.03, 0.15, 0.03
_MOST_UNEVEN = 1e12  # squared swings: for a pixel without swing
# Full scale of the light, 10 bits: in the dark, which tone curves spread, small differences are still a few grey
# levels.
FULL_SCALE = 1023


@dataclass(frozen=True)
class CameraResponse:
    """The inverse response of a camera."""

    light: Floats
    """(levels,): light of grey levels evenly spaced from 0 to the top, relative to that of the last."""
    top: float
    """The last grey level."""
    saturation: float
    """Pixels are clipped from this grey level on."""

    def apply(self, frames: PartOfFrames, places: Sequence[int]) -> Iterator[Image]:
        """Yield the light of the frames (...) at some places."""
        return map(self.light_of, frames.read(places))

    def light_of(self, frame: Image) -> Image:
        """Convert grey levels to light, as 16-bit integers; values brighter than white are clipped
        to the table's end.
        """
        if frame.dtype == np.uint8 and len(self._table) == 256:
            return cast(Image, cv2.LUT(frame, self._table).reshape(frame.shape))  # many times as fast
        return cast(Image, np.take(self._table, frame, mode="clip"))

    @cached_property
    def _table(self) -> NDArray[np.uint16]:
        levels = np.arange(int(self.top) + 1)
        light = np.rint(FULL_SCALE * np.interp(levels, np.linspace(0, self.top, len(self.light)), self.light))
        light[levels >= self.saturation] = FULL_SCALE
        return light.astype(np.uint16)


def camera_response(plan: SequencePlan, levels: Floats32, saturation: float, top: float) -> CameraResponse | None:
    """Estimate the response from the levels (frames, P) of lit pixels below `saturation`, in all frames, up to `top`.

    None if the sums are equal without it, or not equal with it.
    """
    if levels.shape[1] < FEWEST_PIXELS:
        return None
    relative: Floats32 = levels / np.float32(top)
    if len(plan.complements) >= MAJORITY:
        light = _of_inverses(plan, evenly_spread(relative, TRIAL_PIXELS, axis=-1))
    else:
        light = _of_bits(plan, relative)
    return None if light is None else CameraResponse(light / light[-1], top, saturation)


@dataclass(frozen=True)
class _Fit:
    """The values of g (_LEVELS,), and how uneven the sums of light are `before` and `after` linearisation."""

    light: Floats
    before: float
    after: float

    def is_likely(self, notable: float) -> bool:
        """Whether the sums are notably uneven without the curve, and hardly with it."""
        return self.before >= notable and self.after <= min(notable, _LEFT * self.before)


def _fit(groups: list[Floats], swing: Floats, stiffness: float) -> _Fit:
    """Fit g to groups of sums (sums, P, _LEVELS); the sums of a group are to be equal.

    A curve that is flat where the levels are would level anything. What it leaves is therefore divided by the square of
    the geometric mean of its slopes there, relative to its swing, as the likelihood of a transformation is (Box and
    Cox, JRSS B 26, 1964). No camera is as flat as that over much of its range.
    """
    light = _levelling(np.concatenate([sums - sums.mean(axis=0) for sums in groups]), swing, stiffness)
    before, after = (sum(_unevenness(sums @ g, swing @ g) for sums in groups) for g in (_LINEAR, light))
    density = np.concatenate(groups).mean(axis=(0, 1))
    density /= density.sum()
    slopes = np.gradient(light) / np.gradient(_LINEAR) * np.mean(swing @ _LINEAR) / np.mean(swing @ light)
    if density @ (slopes < FEW) > FEW:
        return _Fit(light, before, inf)
    return _Fit(light, before, after * exp(-2 * float(density @ np.log(np.maximum(slopes, _LEAST_SLOPE)))))


def _fit_in_one_light(sums: Floats, swing: Floats, times: Ints) -> _Fit:
    """Fit g to all sums (sums, P, _LEVELS) or, if ambient light changed before a frame, to those with none, one or both
    of their frames from then on, by the places `times` (sums, 2) of these. Some sums must be on either side, or the
    curve at levels that are only there is anything.

    Each further light adds an unknown to each pixel, so the evidence for a change is weighed by Schwarz's criterion
    (BIC): −2 log likelihood is the number of sums times the logarithm of what is left of them. As pixels are not
    independent, half of that must go at least.
    """
    stiffness = 1 / len(swing)
    common = _fit([sums], swing, stiffness)
    every_change = (np.sum(times >= place, axis=1) for place in range(times.min(), times.max() + 1))
    changes = [
        after for after in every_change if min(np.sum(after == end) for end in (after.min(), after.max())) >= MAJORITY
    ]
    penalties = np.array([float(sums[..., 0].size) ** ((len({*after.tolist()}) - 1) / len(sums)) for after in changes])

    def in_groups(values: Floats, after: Ints) -> list[Floats]:
        return [values[after == count] for count in np.unique(after)]

    best, least, lights = common, common.after, [_LINEAR, common.light]
    for light in lights:
        of_light, of_swing = sums @ light, swing @ light
        uneven = [sum(_unevenness(group, of_swing) for group in in_groups(of_light, after)) for after in changes]
        place = int(np.argmin(uneven * penalties))
        fit = _fit(in_groups(sums, changes[place]), swing, stiffness)
        if max(1 / HALF, penalties[place]) * fit.after < least:
            best, least = fit, penalties[place] * fit.after
            lights.append(fit.light)  # by which the moment may be another one
    return best


def _of_inverses(plan: SequencePlan, levels: Floats32) -> Floats | None:
    """Return the values (_LEVELS,) of the g that makes the sums of pairs equal at pixels of `levels` (frames, P), if
    one does.
    """
    numbers = np.array(plan.complements)
    pairs, times = levels[numbers], np.array([[plan.shown.index(number) for number in pair] for pair in numbers])
    darkest, brightest = levels.min(axis=0), levels.max(axis=0)
    if _unevenness(pairs.sum(axis=1), brightest - darkest) < _NOTABLE:
        return None
    fit = _fit_in_one_light(_sums_of(pairs), _interpolation(brightest) - _interpolation(darkest), times)
    # A change of ambient light may explain everything. Other causes, as a dark white frame, leave much, and brightness
    # of the frames is likelier if it leaves less.
    most = _uneven_by_gains(pairs, brightest - darkest)
    return fit.light if fit.is_likely(_NOTABLE) and fit.after <= most else None


def _of_bits(plan: SequencePlan, levels: Floats32) -> Floats | None:
    """Return the same for fine bits without inverses, from narrow stripes or else from wide ones; None without such
    bits.
    """
    by_axis = _fine_bits(plan)
    if not by_axis or plan.white is None or plan.black is None:
        return None
    ends = levels[[plan.white, plan.black]]
    evidence = chain(_of_narrow_stripes(levels, ends, by_axis), _of_wide_stripes(levels, ends, by_axis))
    for sums, swing, stiffness, notable in evidence:
        # Bits are darker than white and black if stripes lose light, or if white differs in patterns.
        if np.all(swing @ _LINEAR > 0) and np.sum((sums - sums[0]) @ _LINEAR) > 0:
            fit = _fit([sums], swing, stiffness)
            if fit.is_likely(notable):
                return fit.light
    return None


# Sums (sums, P, _LEVELS) that are to be equal, swings (P, _LEVELS), the stiffness of g, and notable unevenness.
_Evidence = Iterator[tuple[Floats, Floats, float, float]]


def _of_narrow_stripes(levels: Floats32, ends: Floats32, by_axis: list[list[int]]) -> _Evidence:
    """Yield averages over groups of equally bright pixels, of which each fine bit lights half.

    `ends` (2, P): white and black.
    """
    bits = [frame for frames in by_axis for frame in frames]
    ordered = _interpolation(np.concatenate([ends, levels[bits]])[:, np.argsort(ends[0])])
    starts = np.arange(_GROUPS) * levels.shape[1] // _GROUPS
    counts = np.diff(starts, append=levels.shape[1])
    white, black, *of_bits = np.add.reduceat(ordered, starts, axis=1) / counts[:, None]
    yield np.stack([white + black, *(2 * bit for bit in of_bits)]), white - black, 1 / _GROUPS, _NOTABLE_OF_BITS


def _of_wide_stripes(levels: Floats32, ends: Floats32, by_axis: list[list[int]]) -> _Evidence:
    """Yield pairs of single pixels: the brightest and the darkest of an axis's fine bits, and white and black (2, P).

    Other surfaces send as much light to both, half of what they send to white, so that these are at medium levels.
    Pixels whose bits are not all at one of the two are left out: their stripes are blurred rather than wide.
    """
    pairs = np.array([ends, *([levels[frames].max(axis=0), levels[frames].min(axis=0)] for frames in by_axis)])
    swings = pairs[:, 0] - pairs[:, 1]
    is_wide = np.all(swings[1:] > HALF * swings[0], axis=0) & (swings[0] > 0)
    for frames, pair, swing in zip(by_axis, pairs[1:], swings[1:], strict=True):
        is_wide &= np.abs(levels[frames] - pair.mean(axis=0)).min(axis=0) > HALF * swing / 2
    wide = np.flatnonzero(is_wide)
    if len(wide) >= FEWEST_PIXELS:
        some: Floats32 = evenly_spread(pairs[..., wide], TRIAL_PIXELS, axis=-1)
        yield _sums_of(some), _interpolation(some[0, 0]) - _interpolation(some[0, 1]), _STIFF, _NOTABLE


def _fine_bits(plan: SequencePlan) -> list[list[int]]:
    """Return, for each axis that has any, the frames of its fine bits without inverses."""
    by_axis = [
        [
            frame
            for code in axis.codes
            for bit, frame in code.unpaired.items()
            if bit >= code.bits - _FINE_BITS and not isinstance(plan.patterns[frame], Xor)
        ]
        for axis in plan.axes
    ]
    return [frames for frames in by_axis if frames]


def _uneven_by_gains(pairs: Floats32, swing: Floats32) -> float:
    """Return how uneven the sums of pairs (N, 2, P) are, in swings (P,), once all frames are equally bright."""
    usual = pairs.sum(axis=1).mean(axis=0)
    return _unevenness(np.stack([residual_of_gains(pair, usual) for pair in pairs]), swing.astype(np.float64))


def _sums_of(pairs: Floats32) -> Floats:
    """Return the sums (N, P, _LEVELS) of pairs (N, 2, P)."""
    return _interpolation(pairs[:, 0]) + _interpolation(pairs[:, 1])


def _interpolation(levels: Floats32) -> Floats:
    """Return the weights (…, _LEVELS) by which the values of g give g(I), for I (…) from 0 to 1."""
    place = np.clip(levels, 0, 1) * (_LEVELS - 1)
    weights: Floats = np.maximum(0, 1 - np.abs(place[..., None] - np.arange(_LEVELS)))
    return weights


def _levelling(off: Floats, swing: Floats, stiffness: float) -> Floats:
    """Return the values (_LEVELS,) of g that minimise `off` @ g relative to the swings, with the mean swing kept.

    `off` (sums, P, _LEVELS): the sums minus their mean; `swing` (P, _LEVELS).
    """
    rows, mean = off.reshape(-1, _LEVELS), swing.mean(axis=0)
    bends = np.diff(np.eye(_LEVELS), 2, axis=0)
    stiff = stiffness * bends.T @ bends
    light, weights = _LINEAR, np.ones(len(rows))
    given, offset = np.outer(mean, mean), np.outer(np.eye(_LEVELS)[0], np.eye(_LEVELS)[0])
    as_it_is = mean * float(mean @ _LINEAR)
    for _ in range(HUBER_ROUNDS):
        relative = np.tile(1 / np.maximum(swing @ light, NEGLIGIBLE), len(off))
        normal = rows.T @ ((weights * relative**2)[:, None] * rows) / len(rows) + stiff
        light = _rising(np.linalg.solve(normal + _HELD * (given + offset), _HELD * as_it_is).astype(np.float64))
        away = relative * np.abs(rows @ light)
        weights = 1 / (1 + (away / (OUTLYING_SIGMAS * robust_sigma(away) + 1e-4)) ** 2)
    return light


def _rising(light: Floats) -> Floats:
    """Return the curve (_LEVELS,) from 0 on, with no slope below the least share of its mean slope."""
    slopes = np.diff(light)
    return np.concatenate([[0.0], np.cumsum(np.maximum(slopes, _LEAST_SLOPE * np.mean(slopes)))])


def _unevenness(sums: Floats, swing: Floats) -> float:
    """Return the squared deviation of the sums (sums, P) from the median sum, in swings (P,): median pixel, summed."""
    with np.errstate(invalid="ignore", divide="ignore"):  # pixels without swing
        off = (sums - np.median(sums, axis=0)) / swing
    return float(np.sum(np.median(np.nan_to_num(off**2, posinf=_MOST_UNEVEN), axis=1)))
