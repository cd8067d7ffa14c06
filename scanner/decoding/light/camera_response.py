"""Estimate the camera's response curve from sums of frames, and linearise frames with it.

A pattern and its inverse add up to the same light as every other pair. Blurred stripes contribute two medium levels,
sharp ones a dark and a bright level, so that a tone curve, as of photographs, makes their sums differ. The inverse
response g = f⁻¹ makes all sums equal, g(I) + g(I') = M at every pixel: least squares in the values of g at a few levels
(radiometric self-calibration, after Mitsunaga and Nayar, CVPR 1999). The rest of the decoder works in the linear light
g(I).
"""

from dataclasses import dataclass
from functools import cached_property
from math import exp, inf
from typing import cast

import numpy as np
from numpy.typing import NDArray

from calib.numerics import SIGMA_PER_MEDIAN, Floats, Image, median
from scanner.decoding.arrays import NEGLIGIBLE, Floats32
from scanner.decoding.light.brightness import left_by_gains
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEW, FEWEST_PIXELS, HALF, HUBER_ROUNDS, MAJORITY, OUTLYING_SIGMAS
from scanner.decoding.subsampling import TRIAL_PIXELS, evenly_spread
from scanner.patterns import Xor

# Number of levels between which g is linear; weight of its second differences relative to one pixel's sums; weight of
# the constraints relative to all pixels.
_LEVELS, _STIFFNESS, _HELD = 17, 1.0, 10.0
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
_FULL_SCALE = 1023


@dataclass(frozen=True)
class CameraResponse:
    """The inverse response: `light` (levels,) of grey levels evenly spaced from 0 to `top`, relative to that of the
    last.

    Pixels are clipped from grey level `saturation` on.
    """

    light: Floats
    top: float
    saturation: float

    def light_of(self, frame: Image) -> Image:
        """Convert grey levels to light, as 16-bit integers; values brighter than white are clipped
        to the table's end.
        """
        return cast(Image, np.take(self._table, frame, mode="clip"))

    @cached_property
    def _table(self) -> NDArray[np.uint16]:
        levels = np.arange(int(self.top) + 1)
        light = np.rint(_FULL_SCALE * np.interp(levels, np.linspace(0, self.top, len(self.light)), self.light))
        light[levels >= self.saturation] = _FULL_SCALE
        return light.astype(np.uint16)


def camera_response(plan: SequencePlan, levels: Floats32, saturation: float, top: float) -> CameraResponse | None:
    """Estimate the response from the levels (frames, P) of lit pixels below `saturation`, in all frames, up to `top`.

    None if the sums are equal without it, or not equal with it.
    """
    if levels.shape[1] < FEWEST_PIXELS:
        return None
    has_pairs = len(plan.complements) >= MAJORITY
    some: Floats32 = evenly_spread(levels, TRIAL_PIXELS, axis=-1) if has_pairs else levels
    seen = some / np.float32(top)
    found = _of_pairs(plan, seen) if has_pairs else _of_bits_alone(plan, seen)
    if found is None:
        return None
    fit = _fit_in_one_light(*found) if has_pairs else _fit([found[0]], found[1])
    notable = _NOTABLE if has_pairs else _NOTABLE_OF_BITS
    # A change of ambient light may explain everything. Other causes, as a dark white frame, leave much, and brightness
    # of the frames is likelier if it leaves less.
    most = min(notable, _LEFT * fit.before, _left_by_gains(plan, seen) if has_pairs else notable)
    is_likely = fit.before >= notable and fit.after <= most
    return CameraResponse(fit.light / fit.light[-1], top, saturation) if is_likely else None


@dataclass(frozen=True)
class _Fit:
    """The values of g (_LEVELS,), and how uneven the sums of light are `before` and `after` linearisation."""

    light: Floats
    before: float
    after: float


def _fit(groups: list[Floats], swing: Floats) -> _Fit:
    """Fit g to groups of sums (sums, P, _LEVELS); the sums of a group are to be equal.

    A curve that is flat where the levels are would level anything. What it leaves is therefore divided by the square of
    the geometric mean of its slopes there, relative to its swing, as the likelihood of a transformation is (Box and
    Cox, JRSS B 26, 1964). No camera is as flat as that over much of its range.
    """
    light = _levelling(np.concatenate([sums - sums.mean(axis=0) for sums in groups]), swing)
    before, after = (sum(_unevenness(sums @ g, swing @ g) for sums in groups) for g in (_LINEAR, light))
    seen = np.concatenate(groups).mean(axis=(0, 1))
    seen /= seen.sum()
    slopes = np.gradient(light) / np.gradient(_LINEAR) * np.mean(swing @ _LINEAR) / np.mean(swing @ light)
    if seen @ (slopes < FEW) > FEW:
        after = inf
    return _Fit(light, before, after * exp(-2 * float(seen @ np.log(slopes))))


def _fit_in_one_light(sums: Floats, swing: Floats) -> _Fit:
    """Fit g to all sums (sums, P, _LEVELS) or, if ambient light changed, to those before and to those after it.

    A change adds an unknown light to each pixel, so the evidence for it is weighed by Schwarz's criterion (BIC): −2 log
    likelihood is the number of sums times the logarithm of what is left of them. As pixels are not independent, half of
    that must go at least.
    """
    best = alike = _fit([sums], swing)
    for light in (_LINEAR, alike.light):
        of_light, of_swing = sums @ light, swing @ light
        left = [
            _unevenness(of_light[:place], of_swing) + _unevenness(of_light[place:], of_swing)
            for place in range(1, len(sums))
        ]
        place = 1 + int(np.argmin(left))
        best = min(best, _fit([sums[:place], sums[place:]], swing), key=lambda fit: fit.after)
    is_changed = best.after < alike.after * min(HALF, (len(sums) * len(swing)) ** (-1 / len(sums)))
    return best if is_changed else alike


def _of_pairs(plan: SequencePlan, seen: Floats32) -> tuple[Floats, Floats] | None:
    """Return the sums of pairs in capture order and the swings, at pixels `seen` (frames, P); None if they are even.

    Sums (pairs, P, _LEVELS) and swings (P, _LEVELS) are linear in the values of g.
    """
    first, second = np.array(sorted(plan.complements, key=lambda pair: plan.shown.index(pair[1]))).T
    darkest, brightest = seen.min(axis=0), seen.max(axis=0)
    if _unevenness(seen[first] + seen[second], brightest - darkest) < _NOTABLE:
        return None
    swing = _interpolation(brightest) - _interpolation(darkest)
    return _interpolation(seen[first]) + _interpolation(seen[second]), swing


def _left_by_gains(plan: SequencePlan, seen: Floats32) -> float:
    """Return how uneven the sums of pairs are, at pixels `seen` (frames, P), once all frames are equally bright."""
    pairs = np.array(plan.complements)
    usual = seen[pairs].sum(axis=1).mean(axis=0)
    return _unevenness(np.stack([left_by_gains(seen[pair], usual) for pair in pairs]), np.ptp(seen, axis=0))


def _of_bits_alone(plan: SequencePlan, seen: Floats32) -> tuple[Floats, Floats] | None:
    """Return the same as `_of_pairs` for fine bits without inverses, compared with white plus black.

    Averages over groups of equally bright pixels replace pairs, as half of the pixels are lit. None without such bits,
    without white or black, or if the bits are darker.
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
    # Darker bits mean that stripes lose light, or that white differs in patterns.
    if np.any(swing @ _LINEAR <= 0) or np.sum((sums - white - black) @ _LINEAR) <= 0:
        return None
    sums = np.concatenate([[white + black], sums])
    return (sums, swing) if _unevenness(sums @ _LINEAR, swing @ _LINEAR) >= _NOTABLE_OF_BITS else None


def _interpolation(levels: Floats32) -> Floats:
    """Return the weights (…, _LEVELS) by which the values of g give g(I), for I (…) from 0 to 1."""
    place = np.clip(levels, 0, 1) * (_LEVELS - 1)
    weights: Floats = np.maximum(0, 1 - np.abs(place[..., None] - np.arange(_LEVELS)))
    return weights


def _levelling(off: Floats, swing: Floats) -> Floats:
    """Return the values (_LEVELS,) of g that minimise `off` @ g relative to the swings, with the mean swing kept.

    `off` (sums, P, _LEVELS): the sums minus their mean; `swing` (P, _LEVELS).
    """
    rows, mean = off.reshape(-1, _LEVELS), swing.mean(axis=0)
    bends = np.diff(np.eye(_LEVELS), 2, axis=0)
    stiff = _STIFFNESS / len(swing) * bends.T @ bends
    light, weights = _LINEAR, np.ones(len(rows))
    given, offset = np.outer(mean, mean), np.outer(np.eye(_LEVELS)[0], np.eye(_LEVELS)[0])
    as_it_is = mean * float(mean @ _LINEAR)
    for _ in range(HUBER_ROUNDS):
        relative = np.tile(1 / np.maximum(swing @ light, NEGLIGIBLE), len(off))
        normal = rows.T @ ((weights * relative**2)[:, None] * rows) / len(rows) + stiff
        light = _rising(np.linalg.solve(normal + _HELD * (given + offset), _HELD * as_it_is).astype(np.float64))
        away = relative * np.abs(rows @ light)
        weights = 1 / (1 + (away / (OUTLYING_SIGMAS * SIGMA_PER_MEDIAN * median(away) + 1e-4)) ** 2)
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
