"""What the light of the frames must satisfy, whatever the scene, and the noise with which it does.

White is the brightest of all frames and black the darkest. Pattern and inverse add up to the same light in every pair.
The mean of a fringe is the same part of white everywhere, and its steps lie on a cosine, apart from the harmonics of a
nonlinear brightness curve, which follow its phase. What frames miss of this is their residual. A hypothesis, such as
that two frames were exchanged or that a lamp was switched on, is judged by what it leaves of it.

The camera's noise is what remains in a capture without any fault: the same light was shown twice, and differs. If a
sequence has few such repeats, the curvature of the frames along rows is used as well; edges of the scene do not move
its median (after Immerkær, CVIU 64, 1996).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import sqrt
from typing import Any, Self, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.numerics import SEED, Bools, Floats, Floats32, Ints, fit_reweighted, median, medians, quantile, robust_sigmas
from scanner.decoding.light.samples import Sample
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, Fringe, SequencePlan
from scanner.decoding.significance import (
    FEW,
    FEWEST_PIXELS,
    HALF,
    HUBER_SIGMAS,
    OUTLYING_SIGMAS,
    REFITS,
    SIGNIFICANT_SIGMAS,
)


@dataclass(frozen=True)
class ConstraintSet:
    """Combinations of the frames of a sequence that vanish in steady light, and what frames leave of them.

    `levels` (frames, P) are grey levels of pixels in all frames, here and below.
    """

    plan: SequencePlan
    """Of the sequence."""

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Frames that add up to the same light, two by two."""
        return tuple(self.plan.complements)

    @cached_property
    def even(self) -> tuple[Fringe, ...]:
        """The fringes in equal steps, whose frames add up to the same light if they are as many."""
        return tuple(fringe for fringe in self.plan.fringes if fringe.equal_steps)

    @cached_property
    def kinds(self) -> list[Sequence[tuple[int, ...]]]:
        """Groups of frames, those of a kind with equal sums: pairs, and fringes; without a group that is alone."""
        every = self.pairs, [fringe.frames for fringe in self.even]
        return [groups for groups in every if len(groups) > 1]

    def sums_off(self, levels: Floats32, groups: Sequence[Sequence[int]]) -> Floats32:
        """Return how far the sums of groups of frames are from the usual one, (groups, P)."""
        sums = np.stack([np.sum(levels[list(frames)], axis=0) for frames in groups])
        return sums - medians(sums, axis=0)

    def beyond_ends(self, levels: Floats32) -> Iterator[tuple[int, Floats32]]:
        """Yield white and black, each with how much brighter or darker than it every frame is, (frames, P)."""
        for frame, side in ((self.plan.white, 1), (self.plan.black, -1)):
            if frame is not None:
                yield frame, np.maximum(side * (levels - levels[frame]), 0)

    def off_cosine(self, fringe: Fringe, levels: Floats32) -> Floats32:
        """Return what the least-squares fit of a fringe leaves of its steps, (N, P)."""
        steps = levels[list(fringe.frames)]
        return steps - (fringe.design @ fringe.weights).astype(np.float32) @ steps

    def residuals(self, levels: Floats32) -> Iterator[Floats32]:
        """Yield what the levels miss of all constraints, (combinations, P) of each kind."""
        yield from (excess for _, excess in self.beyond_ends(levels))
        yield from (self.sums_off(levels, groups) for groups in self.kinds)
        yield from (self.off_cosine(fringe, levels) for fringe in self.plan.fringes)

    def repeats(self, levels: Floats32) -> Iterator[tuple[Floats32, Floats32]]:
        """Yield, for light shown twice, its level (P,) and a difference (P,) with the variance of one pixel."""
        for a, b in pairwise(levels[first] + levels[second] for first, second in self.pairs):
            yield (a + b) / 4, (a - b) / 2
        for fringes in pairwise(self.plan.fringes):
            weights = [fringe.weights[0].astype(np.float32) for fringe in fringes]
            a, b = (weight @ levels[list(f.frames)] for weight, f in zip(weights, fringes, strict=True))
            gain = np.sqrt(sum(np.sum(weight**2) for weight in weights))
            yield (a + b) / 2, (a - b) / np.float32(gain)


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


def measure_noise(plan: SequencePlan, sample: Sample, saturation: float) -> NoiseModel:
    """Fit the noise model to a sample of all frames, excluding pixels that reach `saturation` in any of them."""
    levels = sample.levels
    unsaturated = levels.max(axis=0) < saturation
    if not unsaturated.any():
        return NoiseModel(_QUANTISATION, 0.0)
    contrast = float(np.quantile(np.ptp(levels, axis=0), _BRIGHTEST))
    repeats = [*ConstraintSet(plan).repeats(levels)]
    if (curvature := sample.curvature) is not None:
        repeats += [(level, bend / np.float32(np.sqrt(6))) for level, bend in zip(levels, curvature, strict=True)]
    means, differences = (np.stack(parts)[:, unsaturated] for parts in zip(*repeats, strict=True))
    noise = _fit(*_variance_by_level(medians(means, axis=0), differences))
    return replace(noise, stray=min(max(_ROUNDING, STRAY_PART * contrast), _MOST_STRAY))


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


@dataclass(frozen=True)
class LitSample:
    """Lit pixels of a sample, as taken or by a hypothesis about their light."""

    constraints: ConstraintSet
    """On the frames."""
    levels: Floats32
    """(frames, P): grey levels."""
    swing: Floats32
    """(P,): range of each pixel as taken."""
    sigma: Floats32
    """(P,): noise of a pixel half-way between its extremes, in grey levels."""

    @classmethod
    def of(cls, constraints: ConstraintSet, levels: Floats32, noise: NoiseModel) -> Self:
        """Return all pixels with these levels (frames, P)."""
        high, low = levels.max(axis=0), levels.min(axis=0)
        return cls(constraints, levels, high - low, noise.sigma((high + low) / 2))

    def at(self, pixels: Ints) -> Self:
        """Return some of the pixels."""
        return replace(self, levels=self.levels[:, pixels], swing=self.swing[pixels], sigma=self.sigma[pixels])

    def by(self, levels: Floats32) -> Self:
        """Return the pixels with the levels (frames, P) that they have by a hypothesis."""
        return replace(self, levels=levels)

    @cached_property
    def inconsistency(self) -> float:
        """Sum of squares of all residuals of the constraints, in swings, per pixel."""
        # No light is negative: for a single pair of frames, only this shows before which of them the light changed.
        residuals = [np.minimum(self.levels, 0), *self.constraints.residuals(self.levels)]
        return sum(float(np.sum((residual / self.swing) ** 2)) for residual in residuals) / len(self.swing)


# Least share of the lit pixels that rest: an object may cover more than half of them. These pixels tell the usual
# deviation (a nonlinear camera, a projector that sharpens or dims fine stripes).
STATIC_SHARE = 0.3
# A nonlinear camera sees pairs of fine stripes brighter or darker than others. The factor allows for a lens that mixes
# adjacent black and white by up to a quarter of the swing, with the sRGB response curve.
_OF_FINE = 2.5
_HARMONICS = (2, 3)  # of a nonlinear brightness curve; others are fainter


@dataclass(frozen=True)
class _Group:
    """Frames that must agree with each other or with the other frames."""

    frames: tuple[int, ...]
    """Their numbers."""
    deviation: Floats32
    """(P,): from agreement, in grey levels."""
    noise_gain: float
    """Noise of the deviation for a pixel noise of one."""
    times: float = 1.0
    """Factor on the threshold for a contradiction."""


def find_violations(
    plan: SequencePlan, levels: Floats32, noise: NoiseModel, static: Bools | None = None
) -> list[tuple[tuple[int, ...], Bools]]:
    """Return groups of frames, each with the pixels (P,) of lit `levels` (frames, P) at which they contradict others.

    The `static` pixels (P,) give the usual deviation; None if they are unknown.
    """
    swing = np.ptp(levels, axis=0)
    sigma = np.sqrt(noise.variance(levels.max(axis=0))) / swing
    violations = []
    for group in _groups(ConstraintSet(plan), levels) if levels.size else ():
        deviation = np.abs(group.deviation) / swing
        some = deviation if static is None or not static.any() else deviation[static]
        least = max(group.times * FEW, OUTLYING_SIGMAS * _usual_sigma(some))
        violations.append((group.frames, deviation > np.maximum(least, SIGNIFICANT_SIGMAS * group.noise_gain * sigma)))
    return violations


def _usual_sigma(deviation: NDArray[np.floating[Any]]) -> float:
    """Return the standard deviation of normal deviates with the absolute values (P,) of the pixels that rest."""
    return quantile(deviation, STATIC_SHARE) / (sqrt(2) * float(scipy.special.erfinv(STATIC_SHARE)))


def frames_of_fine_bits(plan: SequencePlan) -> set[int]:
    """Return the frames of bits that camera, projector or scattering may blur.

    An error in one of them moves the coordinate by a few cells only.
    """
    return {frame for code in plan.codes for frame in code.fine_frames}


def _groups(constraints: ConstraintSet, levels: Floats32) -> Iterator[_Group]:
    """Yield the deviations of all groups of frames that must agree at lit pixels, `levels` (frames, P)."""
    plan, even = constraints.plan, constraints.even
    blurred = set() if plan.fringes else frames_of_fine_bits(plan)
    fine = [pair for pair in constraints.pairs if blurred & {*pair}]
    pairs = [pair for pair in constraints.pairs if pair not in fine]
    half_lit, means = (
        [levels[list(frames)].mean(axis=0) for frames in groups] for groups in (pairs, [f.frames for f in even])
    )
    if half_lit or means:
        usual = medians(np.stack(half_lit or means), axis=0)
        for frames in (*pairs, *fine):
            times = _OF_FINE if frames in fine else 1.0
            yield _Group(frames, _deviation_from_usual(levels[list(frames)], usual), 1.0, times)
        ambient = levels.min(axis=0)
        for fringe, light in zip(even, means, strict=True):
            yield _Group(fringe.frames, _deviation_from_mean(fringe, levels, np.stack([light, ambient]), usual), 1.0)
    for fringe in plan.fringes:
        if len(fringe.frames) > COSINE_PARAMETERS:
            yield _Group(fringe.frames, _deviation_from_cosine(constraints, fringe, levels), 1.0)
    yield from _beyond_white(plan, levels)
    yield from _beyond_white_and_black(plan, levels)


def _beyond_white(plan: SequencePlan, levels: Floats32) -> Iterator[_Group]:
    """Yield the excess of the brightest step of each fringe over white, which counts only if it is half of the swing.

    Light in a fringe but not in white comes by way of a moving object: flickering lamps do not make as much.
    """
    if plan.white is not None:
        for fringe in plan.fringes:
            above = levels[list(fringe.frames)].max(axis=0) - levels[plan.white]
            yield _Group(fringe.frames, np.maximum(above, 0), sqrt(2), HALF / FEW)


def _deviation_from_usual(levels: Floats32, usual: Floats32) -> Floats32:
    """Return the deviation of frames (N, P), each scaled to fit best, from the usual light (P,).

    Brightness has mostly been equalised already, but not of the first frames, nor for cameras that respond less to
    bright light.
    """
    _, residual = _fit_most(levels, usual, _most_concentrated(usual / np.maximum(levels.mean(axis=0), 1e-6)))
    return residual


def _most_concentrated(values: Floats32) -> Bools:
    """Return the most concentrated values (P,), as many as the least share of resting pixels.

    A moving object near a lamp is brighter than all that rests, and would bias a mean.
    """
    count = max(1, round(STATIC_SHARE * len(values)))
    ordered = np.sort(values)
    start = int(np.argmin(ordered[count - 1 :] - ordered[: len(ordered) - count + 1]))
    return cast(Bools, (values >= ordered[start]) & (values <= ordered[start + count - 1]))


def _deviation_from_mean(fringe: Fringe, frames: Floats32, parts: Floats32, usual: Floats32) -> Floats32:
    """Return the deviation of the usual light (P,) from a combination of the mean and the ambient light, `parts` (2,
    P).

    A nonlinear projector changes the mean, and adds the harmonic whose order is the number of steps. Interreflection
    may give this harmonic any phase, so that deviations of its size are not taken for motion. A camera's tone curve
    bends the mean of blurred stripes and that of white and black differently. The mean is then a smooth function of the
    usual light, a cubic here, and deviates from it.
    """
    _, cosine, sine = fringe.weights.astype(np.float32) @ frames[list(fringe.frames)]
    phase, amplitude = len(fringe.frames) * np.arctan2(sine, cosine), np.hypot(cosine, sine)
    every = np.stack([*parts, amplitude * np.cos(phase), amplitude * np.sin(phase)])
    brightness, residual = _fit_most(every, usual, _most_concentrated(usual / np.maximum(parts[0], 1e-6)))
    far = FEW * np.ptp(frames, axis=0)
    if contradict := np.count_nonzero(np.abs(residual) > far):
        relative = usual / max(float(usual.max()), 1e-6)
        curved = np.stack([usual, *every[1:], usual * relative, usual * relative**2])
        by_curve, left_of_curve = _fit_most(curved, parts[0], np.ones(len(usual), np.bool_))
        # With a tone curve none contradict any more, and all where something moved.
        if np.count_nonzero(np.abs(left_of_curve) > far) < HALF * contradict:
            brightness, residual = by_curve, left_of_curve
    # A fringe's amplitude is at most half the range; the harmonic may be missing in one place and doubled in another.
    bent = np.float32(np.hypot(*brightness[2:4])) * (frames.max(axis=0) - parts[1])
    return cast(Floats32, np.maximum(np.abs(residual) - bent, 0))


def _fit_most(terms: Floats32, targets: Floats32, first: Bools) -> tuple[Floats, Floats32]:
    """Fit the targets (P,) or (K, P) by the terms (N, P), trimmed to pixels that agree.

    Returns the factors, (N,) or (N, K), and the residuals, shaped like the targets. `first` (P,): pixels of the first
    fit.
    """

    def most(residual: Floats) -> Floats:
        size = np.abs(residual) if residual.ndim == 1 else np.sqrt(np.mean(residual**2, axis=0))
        return (size <= max(HUBER_SIGMAS * _usual_sigma(size), 1e-6)).astype(np.float64)

    of = terms.astype(np.float64)
    factors = fit_reweighted(of, targets.astype(np.float64), most, first.astype(np.float64), REFITS)
    return factors, (targets - factors.T @ of).astype(np.float32)


def _beyond_white_and_black(plan: SequencePlan, levels: Floats32) -> Iterator[_Group]:
    """Yield the excess of bits without an inverse, `levels` (frames, P), beyond white and black."""
    alone = [frame for code in plan.codes for frame in code.unpaired.values()]
    if not alone or plan.white is None or plan.black is None:
        return
    ordered = np.sort(levels[alone], axis=0)
    # White itself may be the corrupted frame, which then does no harm. About half of the bits are lit at each pixel.
    few = round(STATIC_SHARE * (len(alone) - 1))
    most, least = np.maximum(levels[plan.white], ordered[-1 - few]), np.minimum(levels[plan.black], ordered[few])
    for frame in alone:
        bright = levels[frame] > (most + least) / 2
        brighter = median(levels[frame][bright] / np.maximum(most[bright], 1)) if bright.any() else 1.0
        above = levels[frame] / np.float32(max(brighter, 1.0)) - most
        below = least - levels[frame] / np.float32(min(brighter, 1.0))
        yield _Group((frame,), np.maximum(np.maximum(above, below), 0), sqrt(2))


def _deviation_from_cosine(constraints: ConstraintSet, fringe: Fringe, levels: Floats32) -> Floats32:
    """Return the rms (P,) of the residuals of a fringe's steps from a cosine and its harmonics.

    The harmonics are first fitted where residuals are least, since more than half of the rest may be motion.
    """
    steps, residual = levels[list(fringe.frames)], constraints.off_cosine(fringe, levels)
    _, cosine, sine = fringe.weights.astype(np.float32) @ steps
    phase, amplitude = np.arctan2(sine, cosine), np.hypot(cosine, sine)
    terms = np.stack([amplitude * wave(k * phase) for k in _HARMONICS for wave in (np.cos, np.sin)])
    size = np.sqrt(np.mean(residual**2, axis=0)) / np.maximum(np.ptp(steps, axis=0), 1e-6)
    _, residual = _fit_most(terms, residual, size <= quantile(size, STATIC_SHARE))
    return cast(Floats32, np.sqrt(np.mean(residual**2, axis=0)))
