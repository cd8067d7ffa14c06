"""The camera's response curve, from sums of frames, and frames taken back to light.

A pattern and its inverse make the same light as every other pair. Blurred stripes make it of two middling levels, sharp
ones of a dark and a bright level, so that a tone curve, as of photographs, makes their sums differ. The curve f of
which g = f⁻¹ makes all sums alike, g(I) + g(I') = M at every pixel, is the camera's: least squares in the values of g
at a few levels (radiometric self-calibration, after Mitsunaga and Nayar, CVPR 1999). In the light g(I) all the rest
holds: what adds up, what is half-way, what is a cosine.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Image, median
from scanner.decoding.arrays import Floats32
from scanner.decoding.light.lit_pixels import thinned, unclipped
from scanner.decoding.sequence_plan import SequencePlan
from scanner.patterns import Xor

# g is linear between so many levels; how much its second differences weigh against one pixel's sums, and what is given
# against all.
_LEVELS, _STIFFNESS, _HELD = 17, 1.0, 10.0
_LINEAR = np.linspace(0, 1, _LEVELS)
_ROUNDS = 4
# Farther off the sums than so many times what most are counts less: something moves there, or flickers.
_OUTLYING = 4.5
_FEWEST_PAIRS, _FEWEST_PIXELS, _MOST_PIXELS = 3, 200, 1000
# So many bits of a code have stripes of which many are in view; in so many groups of pixels half are lit of each.
_FINE_BITS, _GROUPS = 4, 16
# The squares of what sums are off, in swings, added up over pairs: less is no matter. The right curve leaves a tenth of
# them; nothing else that bends sums leaves so little to a curve that rises everywhere, by this part of its mean slope.
_NOTABLE, _NOTABLE_OF_BITS, _LEFT, _LEAST_SLOPE = 0.006, 0.03, 0.2, 0.03
_MOST_UNEVEN = 1e12  # squared swings: of a pixel that does not swing
_SWITCHED = 0.5  # what light that was switched leaves where it is why sums differ
# Where a curve leaves pairs off by more of their swing, contrast is faint, and light in 10 bits would lose some of it.
_FAINT = 0.025
_RARE = 0.001  # levels that are hardly there say nothing of their slope
# In the dark, where photographs spread the light, differences of a few of 10 bits are still a few grey levels.
_FULL_SCALE = 1023


@dataclass(frozen=True)
class CameraResponse:
    """`light` (levels,): that of grey levels evenly spaced from 0 to `top`, in parts of that of the last one. From
    `saturation` on pixels are clipped.
    """

    light: Floats
    top: float
    saturation: float

    def light_of(self, frame: Image) -> Image:
        """The light of grey levels, of 16 bits; some may be brighter than white ever was."""
        return cast(Image, np.take(self._table, frame, mode="clip"))

    @cached_property
    def _table(self) -> NDArray[np.uint16]:
        levels = np.arange(int(self.top) + 1)
        light = np.rint(_FULL_SCALE * np.interp(levels, np.linspace(0, self.top, len(self.light)), self.light))
        light[levels >= self.saturation] = _FULL_SCALE
        return light.astype(np.uint16)


def camera_response(plan: SequencePlan, levels: Floats32, saturation: float, top: float) -> CameraResponse | None:
    """That which a sample `levels` (frames, P) of all frames tells, up to a level `top`; None if sums are even without
    one, or one does not make them so.
    """
    lit = unclipped(levels, saturation)
    if lit.shape[1] < _FEWEST_PIXELS:
        return None
    seen = lit / np.float32(top)
    has_pairs = len(plan.complements) >= _FEWEST_PAIRS
    found = _of_pairs(plan, seen) if has_pairs else _of_bits_alone(plan, seen)
    if found is None:
        return None
    sums, of_swing, notable = found
    fit = _fit([sums], of_swing)
    if fit.before < notable:
        return None
    # Light that is switched on makes sums differ, too: those before it from those after it.
    if has_pairs:
        split = (_fit([sums[:place], sums[place:]], of_swing) for place in range(1, len(sums)))
        switched = min(split, key=lambda each: each.after)
        if switched.after < _SWITCHED * fit.after and switched.before > notable:
            fit = switched
        if fit.after > _FAINT**2 * len(sums):
            return None
    slopes = np.diff(fit.light) / np.mean(np.diff(fit.light))
    count, _ = np.histogram(seen, _LINEAR)
    if fit.after > _LEFT * fit.before or np.any(slopes[count > _RARE * seen.size] < _LEAST_SLOPE):
        return None
    light = np.concatenate([[0.0], np.cumsum(np.maximum(slopes, _LEAST_SLOPE))])
    return CameraResponse(light / light[-1], top, saturation)


@dataclass(frozen=True)
class _Fit:
    """The values of g (_LEVELS,), and how uneven sums of light are `before` and `after` it."""

    light: Floats
    before: float
    after: float


def _fit(groups: list[Floats], swing: Floats) -> _Fit:
    """Of groups of sums (sums, P, _LEVELS), each of which are to be alike."""
    light = _levelling(np.concatenate([sums - sums.mean(axis=0) for sums in groups]), swing)
    before, after = (sum(_unevenness(sums @ g, swing @ g) for sums in groups) for g in (_LINEAR, light))
    return _Fit(light, before, after)


def _of_pairs(plan: SequencePlan, seen: Floats32) -> tuple[Floats, Floats, float]:
    """What makes the sums of pairs, in the order in which they were shown, (pairs, P, _LEVELS), and the swings
    (P, _LEVELS) of g, at pixels `seen` (frames, P); and what unevenness is notable.
    """
    some = thinned(seen, _MOST_PIXELS)
    of_levels = _interpolation(some)
    first, second = np.array(sorted(plan.complements, key=lambda pair: plan.shown.index(pair[1]))).T
    swing = _interpolation(some.max(axis=0)) - _interpolation(some.min(axis=0))
    return of_levels[first] + of_levels[second], swing, _NOTABLE


def _of_bits_alone(plan: SequencePlan, seen: Floats32) -> tuple[Floats, Floats, float] | None:
    """The same of white with black, and of fine bits without inverses with themselves, over pixels that are as bright:
    half of them are lit. None without any, or without white and black, or of darker bits.
    """
    bits = [frame for code in plan.codes for bit, frame in code.unpaired.items() if bit >= code.bits - _FINE_BITS]
    bits = [frame for frame in bits if not isinstance(plan.patterns[frame], Xor)]
    if not bits or plan.white is None or plan.black is None:
        return None
    ordered = _interpolation(seen[[plan.white, plan.black, *bits]][:, np.argsort(seen[plan.white])])
    starts = np.arange(_GROUPS) * seen.shape[1] // _GROUPS
    counts = np.diff(starts, append=seen.shape[1])
    white, black, *of_bits = np.add.reduceat(ordered, starts, axis=1) / counts[:, None]
    sums, swing = 2 * np.stack(of_bits), white - black
    # If they are darker, stripes lose light, or white is another one than in patterns.
    if np.any(swing @ _LINEAR <= 0) or np.sum((sums - white - black) @ _LINEAR) <= 0:
        return None
    return np.concatenate([[white + black], sums]), swing, _NOTABLE_OF_BITS


def _interpolation(levels: Floats32) -> Floats:
    """The weights (…, _LEVELS) with which the values of g make g(I), for I (…) from 0 to 1."""
    place = np.clip(levels, 0, 1) * (_LEVELS - 1)
    weights: Floats = np.maximum(0, 1 - np.abs(place[..., None] - np.arange(_LEVELS)))
    return weights


def _levelling(off: Floats, swing: Floats) -> Floats:
    """The values (_LEVELS,) of g that make `off` @ g least, in swings; in the mean these are as they are without g.

    `off` (sums, P, _LEVELS): what makes the sums, less that of all; `swing` (P, _LEVELS): what makes the swings.
    """
    rows, mean = off.reshape(-1, _LEVELS), swing.mean(axis=0)
    bends = np.diff(np.eye(_LEVELS), 2, axis=0)
    stiff = _STIFFNESS / len(swing) * bends.T @ bends
    light, weights = _LINEAR, np.ones(len(rows))
    given, offset = np.outer(mean, mean), np.outer(np.eye(_LEVELS)[0], np.eye(_LEVELS)[0])
    as_it_is = mean * float(mean @ _LINEAR)
    for _ in range(_ROUNDS):
        of_swing = swing @ light
        of_swing = np.maximum(of_swing, _LEAST_SLOPE * median(of_swing))
        relative = rows / np.tile(of_swing, len(off))[:, None]
        normal = relative.T @ (weights[:, None] * relative) / len(rows) + stiff
        light = np.linalg.solve(normal + _HELD * (given + offset), _HELD * as_it_is).astype(np.float64)
        away = np.abs(relative @ light)
        weights = 1 / (1 + (away / (_OUTLYING * median(away) + 1e-4)) ** 2)
    return light


def _unevenness(sums: Floats, swing: Floats) -> float:
    """How far sums (sums, P) are from most at a pixel, squared, in swings (P,): of the median pixel, added up."""
    with np.errstate(invalid="ignore", divide="ignore"):  # where nothing swings nothing is known
        off = (sums - np.median(sums, axis=0)) / swing
    return float(np.sum(np.median(np.nan_to_num(off**2, posinf=_MOST_UNEVEN), axis=1)))
