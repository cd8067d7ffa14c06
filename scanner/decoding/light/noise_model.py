"""Measure the camera's noise from the frames of the capture itself.

Some combinations of frames show the same light twice: every pattern plus its inverse, white plus black, the mean of
every fringe over its shifts. Their differences are noise. If a sequence has few of them, the curvature of the frames
along rows is used as well; edges of the scene do not move its median (after Immerkær, CVIU 64, 1996).
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calib.numerics import SEED, Floats32, medians, robust_sigmas
from scanner.decoding.light.samples import Sample
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEW, FEWEST_PIXELS, MAJORITY

_QUANTISATION = 1 / 12  # variance of a number that is rounded to integers
_BINS = 10  # of grey levels, for a straight line
# Stray light: largest difference that it may cause, as a share of what the brightest pixels show.
STRAY_PART, _BRIGHTEST = 0.03, 0.995
# Bounds of that difference in grey levels: rounding, and the most that stray light is assumed to cause.
_ROUNDING, _MOST_STRAY = 1.0, 5.0


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a pixel at grey level I: at_black + gain · I."""

    at_black: float
    """Read noise and quantisation."""
    gain: float
    """Shot noise per grey level."""
    stray: float = _MOST_STRAY
    """Smaller differences between frames may be rounding, compression and stray light, whatever the noise."""

    def sigma(self, level: NDArray[np.generic]) -> Floats32:
        """Return the standard deviation in grey levels at each level; any shape."""
        return np.sqrt(self.variance(level))

    def variance(self, level: NDArray[np.generic]) -> Floats32:
        """Return the variance at each level; any shape."""
        variance: Floats32 = level.astype(np.float32)
        variance *= np.float32(self.gain)
        variance += np.float32(self.at_black)
        return variance


def needs_neighbours(plan: SequencePlan) -> bool:
    """Whether a sequence repeats too little light, so that noise must be measured between neighbouring pixels too.

    With a single repeat an exchanged frame would pass for noise.
    """
    return max(0, len(plan.complements) - 1) + max(0, len(plan.fringes) - 1) < MAJORITY


def measure_noise(plan: SequencePlan, sample: Sample, saturation: float) -> NoiseModel:
    """Fit the noise model to a sample of all frames, excluding pixels that reach `saturation` in any of them."""
    levels = sample.levels
    unsaturated = levels.max(axis=0) < saturation
    if not unsaturated.any():
        return NoiseModel(_QUANTISATION, 0.0)
    contrast = float(np.quantile(np.ptp(levels, axis=0), _BRIGHTEST))
    repeats = _repeats(plan, levels)
    curvature = sample.curvature
    if curvature is not None:
        rows = zip(levels, curvature, strict=True)
        repeats += [(level, bend / np.float32(np.sqrt(6))) for level, bend in rows]
    means, differences = (np.stack(parts)[:, unsaturated] for parts in zip(*repeats, strict=True))
    noise = _fit(*_variance_by_level(medians(means, axis=0), differences))
    return replace(noise, stray=min(max(_ROUNDING, STRAY_PART * contrast), _MOST_STRAY))


def _repeats(plan: SequencePlan, levels: Floats32) -> list[tuple[Floats32, Floats32]]:
    """Return, for light that was shown twice, the level (P,) and a difference (P,) with the variance of one pixel."""
    sums = [levels[a] + levels[b] for a, b in plan.complements]
    repeats = [((a + b) / 4, (a - b) / 2) for a, b in pairwise(sums)]
    for first, second in pairwise(plan.fringes):
        weights = [fringe.weights[0].astype(np.float32) for fringe in (first, second)]
        a, b = (weight @ levels[list(f.frames)] for weight, f in zip(weights, (first, second), strict=True))
        gain = np.sqrt(sum(np.sum(weight**2) for weight in weights))
        repeats.append(((a + b) / 2, (a - b) / np.float32(gain)))
    return repeats


def _variance_by_level(level: Floats32, differences: Floats32) -> tuple[list[float], list[float]]:
    """Return mean level and variance in bins of equal width in `level` (P,); `differences` (repeats, P).

    The quieter repeats count: a nonlinear camera adds a difference where stripes are as fine as its pixels.
    """
    # Dither: the median of small integers would jump between multiples of one.
    dithered = differences + np.random.default_rng(SEED).uniform(-0.25, 0.25, len(level)).astype(np.float32)
    bins = np.floor(level / (level.max() + 1e-6) * _BINS).astype(np.int64)
    where, variances = [], []
    for number in range(_BINS):
        chosen = np.flatnonzero(bins == number)
        if len(chosen) >= FEWEST_PIXELS:
            where.append(float(np.mean(level[chosen])))
            variance = robust_sigmas(dithered[:, chosen]) ** 2
            variances.append(float(np.quantile(variance, FEW, method="lower")))
    return where, variances


def _fit(where: list[float], variances: list[float]) -> NoiseModel:
    if not where:
        return NoiseModel(_QUANTISATION, 0.0)
    level, variance = np.array(where), np.maximum(np.array(variances), _QUANTISATION)
    if len(level) == 1:
        return NoiseModel(float(variance[0]), 0.0)
    gain, at_black = np.polyfit(level, variance, 1, w=1 / variance)
    if gain < 0:
        return NoiseModel(float(np.median(variance)), 0.0)
    if at_black < _QUANTISATION:
        lit = level > 0
        at_black, gain = _QUANTISATION, max(0.0, float(np.median((variance - _QUANTISATION)[lit] / level[lit])))
    return NoiseModel(float(at_black), float(gain))
