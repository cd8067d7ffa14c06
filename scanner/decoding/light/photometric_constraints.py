"""What the light of the frames must satisfy, whatever the scene: at the lit pixels of a sample, and pixel by pixel.

White is the brightest of all frames and black the darkest. Pattern and inverse add up to the same light in every pair.
The mean of a fringe is the same part of white everywhere, and its steps lie on a cosine, apart from the harmonics of a
nonlinear brightness curve, which follow its phase. What a frame misses of this is its residual.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import sqrt
from typing import Any, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Bools, Floats, Floats32, fit_reweighted, median, medians, quantile, robust_sigmas
from scanner.decoding.light.samples import NoiseModel
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, Fringe, SequencePlan
from scanner.decoding.significance import FEW, HALF, HUBER_SIGMAS, OUTLYING_SIGMAS, REFITS, SIGNIFICANT_SIGMAS

# Largest share of the lit pixels at which frames may be off by half of what an exchange causes: people and occlusion
# edges cover less, an exchanged frame is wrong where its pattern differs.
_WRONG_SHARE = 0.05
# Largest share that occlusion edges, undersampled stripes and people break of the coordinates that depend on a frame.
# If it shows another pattern, half of them are wrong.
MOST_BROKEN = 0.35
# Exchanged frames are named, and a fringe is none, if a right sequence leaves more than this share of the
# contradictions: all but those of noise and of the projector's and the camera's curves, which leave 0.05.
LEFT_BY_SWAP = 0.3

FRAMES_CONTRADICT = FindingKind(
    "frames-contradict",
    "Some frames do not show what the capture says; most of the picture decodes nevertheless, so it was used.",
    "Keep people out of the picture and the light as it is; switch automatic exposure and white balance off.",
    ("frames", "consistent_share", "epipolar_px"),
)


def anomaly(message: str, frames: Iterable[int]) -> Finding:
    """A contradiction between frames, with a short message and the suspected frames."""
    return Finding(FRAMES_CONTRADICT, Severity.WARNING, message, data={"frames": tuple(frames)})


def suspected(anomalies: Iterable[Finding]) -> set[int]:
    """The frames that any of the anomalies suspects."""
    return {frame for finding in anomalies for frame in finding.numbers("frames")}


@dataclass(frozen=True)
class LitSample:
    """The lit pixels of the sample: `levels` (frames, P), `swing` and noise `sigma` (P,)."""

    levels: Floats32
    swing: Floats32
    sigma: Floats32

    @classmethod
    def of(cls, levels: Floats32, noise: NoiseModel) -> "LitSample":
        """Return all pixels with these levels (frames, P)."""
        high, low = levels.max(axis=0), levels.min(axis=0)
        return cls(levels, high - low, noise.sigma((high + low) / 2))


def range_residuals(plan: SequencePlan, levels: Floats32) -> Iterator[tuple[int, Floats32]]:
    """Yield white and black, each with how much brighter or darker the others are, from `levels` (frames, P)."""
    for frame, side in ((plan.white, 1), (plan.black, -1)):
        if frame is not None:
            yield frame, np.maximum(side * (levels - levels[frame]), 0)


def pair_sum_residuals(plan: SequencePlan, levels: Floats32) -> Floats32:
    """Return how far the sums of pattern and inverse are from the usual one, (pairs, P); no pair if there is one."""
    pairs = np.array(plan.complements if len(plan.complements) > 1 else np.empty((0, 2), np.int64))
    sums: Floats32 = levels[pairs[:, 0]] + levels[pairs[:, 1]]
    return sums - medians(sums, axis=0) if len(sums) else sums


def sinusoid_residuals(fringe: Fringe, levels: Floats32) -> Floats32:
    """Return what the least-squares fit of a fringe leaves of its steps, (N, P), from `levels` (frames, P)."""
    steps = levels[list(fringe.frames)]
    return steps - (fringe.design @ fringe.weights).astype(np.float32) @ steps


def total_inconsistency(plan: SequencePlan, levels: Floats32, swing: Floats32) -> float:
    """Return the sum of squares of all residuals, in swings (P,), per pixel; `levels` (frames, P)."""
    # No light is negative: for a single pair of frames, only this shows before which of them the light changed.
    residuals = [np.minimum(levels, 0), *(excess for _, excess in range_residuals(plan, levels))]
    residuals += [pair_sum_residuals(plan, levels), *(sinusoid_residuals(fringe, levels) for fringe in plan.fringes)]
    if len(plan.fringes) > 1:
        sums = np.stack([np.sum(levels[list(fringe.frames)], axis=0) for fringe in plan.fringes])
        residuals.append(sums - medians(sums, axis=0))
    return sum(float(np.sum((residual / swing) ** 2)) for residual in residuals) / len(swing)


def find_anomalies(plan: SequencePlan, sample: LitSample) -> list[Finding]:
    """Return all contradictions between the frames and the sequence."""
    return [*_extremes(plan, sample), *_pairs(plan, sample), *_fringes(plan, sample)]


def _extremes(plan: SequencePlan, sample: LitSample) -> Iterator[Finding]:
    for frame, excess in range_residuals(plan, sample.levels):
        beyond = excess > HALF * sample.swing
        wrong = np.mean(beyond.any(axis=0))
        if wrong > _WRONG_SHARE:
            suspect = int(np.argmax(np.count_nonzero(beyond, axis=1)))
            yield anomaly(
                f"{plan.name(frame)} is {'darker' if frame == plan.white else 'brighter'} than others at {wrong:.0%} "
                f"of the lit pixels, above all than {plan.name(suspect)}",
                (frame, suspect),
            )


def _pairs(plan: SequencePlan, sample: LitSample) -> Iterator[Finding]:
    wrong = np.mean(np.abs(pair_sum_residuals(plan, sample.levels)) > HALF * sample.swing, axis=1)
    suspects = [
        frame for pair, share in zip(plan.complements, wrong, strict=False) for frame in pair if share > _WRONG_SHARE
    ]
    if suspects:
        yield anomaly(
            f"pattern and inverse do not complement each other at {wrong.max():.0%} of the lit pixels, in "
            f"{plan.names(suspects)}",
            suspects,
        )


def _fringes(plan: SequencePlan, sample: LitSample) -> Iterator[Finding]:
    """Yield the fringes whose mean is uneven, or whose steps make no cosine; blurred ones cannot be checked."""
    levels = {fringe: sample.levels[list(fringe.frames)] for fringe in plan.fringes}
    # Scatter of the steps in standard deviations of the noise; a barely visible fringe has 3.
    visible = [
        fringe
        for fringe, steps in levels.items()
        if median(np.std(steps, axis=0, ddof=1) / sample.sigma) > HUBER_SIGMAS
    ]
    even = [fringe for fringe in visible if fringe.equal_steps]
    means = [levels[fringe].mean(axis=0) for fringe in even]
    usual = medians(np.stack(means), axis=0) if len(even) > 1 else sample.levels.min(axis=0)
    relative_noise = median(sample.sigma / sample.swing)
    for fringe, mean in zip(even, means, strict=True):
        steps, amplitude = len(fringe.shifts), np.hypot(*fringe.weights[1:].astype(np.float32) @ levels[fringe])
        spread = float(robust_sigmas(((mean - usual) / sample.swing)[None])[0])
        # N times the scatter of the mean is about an amplitude if one of N frames shows another pattern, 0.1 to 0.2 of
        # it from harmonics.
        if steps * np.sqrt(max(spread**2 - relative_noise**2 / steps, 0.0)) > HALF * median(amplitude / sample.swing):
            yield anomaly(
                f"the mean of {plan.names(fringe.frames)} is no even grey, as it is for a fringe in equal steps",
                fringe.frames,
            )
    for fringe in visible:
        swings = levels[fringe] - fringe.weights[0].astype(np.float32) @ levels[fringe]
        if np.mean(sinusoid_residuals(fringe, sample.levels) ** 2) > LEFT_BY_SWAP * np.mean(swings**2):
            yield anomaly(f"{plan.names(fringe.frames)} make no fringe together", fringe.frames)


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
    """Return groups of frames, each with the lit pixels (P,) at which they contradict each other or the rest; `levels`
    (frames, P).

    The `static` pixels (P,) give the usual deviation; None if they are unknown.
    """
    swing = np.ptp(levels, axis=0)
    sigma = np.sqrt(noise.variance(levels.max(axis=0))) / swing
    violations = []
    for group in _groups(plan, levels):
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


def _groups(plan: SequencePlan, levels: Floats32) -> Iterator[_Group]:
    """Yield the deviations of all groups of frames that must agree at lit pixels, `levels` (frames, P)."""
    if not levels.shape[1]:
        return
    blurred = set() if plan.fringes else frames_of_fine_bits(plan)
    fine = [pair for pair in plan.complements if blurred & {*pair}]
    pairs = [pair for pair in plan.complements if pair not in fine]
    half_lit = [(levels[a] + levels[b]) / 2 for a, b in pairs]
    even = [fringe for fringe in plan.fringes if fringe.equal_steps]
    means = [levels[list(fringe.frames)].mean(axis=0) for fringe in even]
    usual = medians(np.stack(half_lit or means), axis=0) if half_lit or means else None
    if usual is not None:
        for frames in (*pairs, *fine):
            times = _OF_FINE if frames in fine else 1.0
            yield _Group(frames, _deviation_from_usual(levels[list(frames)], usual), 1.0, times)
        ambient = levels.min(axis=0)
        for fringe, light in zip(even, means, strict=True):
            yield _Group(fringe.frames, _deviation_from_mean(fringe, levels, np.stack([light, ambient]), usual), 1.0)
    for fringe in plan.fringes:
        if len(fringe.frames) > COSINE_PARAMETERS:
            yield _Group(fringe.frames, _deviation_from_cosine(fringe, levels[list(fringe.frames)]), 1.0)
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
    by = usual / np.maximum(levels.mean(axis=0), 1e-6)
    _, residual = _fit_most(levels, usual, _most_concentrated(by))
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


def _deviation_from_cosine(fringe: Fringe, levels: Floats32) -> Floats32:
    """Return the rms (P,) of the residuals of a fringe's steps (N, P) from a cosine and its harmonics.

    The harmonics are first fitted where residuals are least, since more than half of the rest may be motion.
    """
    fit = fringe.weights.astype(np.float32) @ levels
    residual = levels - fringe.design.astype(np.float32) @ fit
    phase, amplitude = np.arctan2(fit[2], fit[1]), np.hypot(fit[1], fit[2])
    terms = np.stack([amplitude * wave(k * phase) for k in _HARMONICS for wave in (np.cos, np.sin)])
    size = np.sqrt(np.mean(residual**2, axis=0)) / np.maximum(np.ptp(levels, axis=0), 1e-6)
    _, residual = _fit_most(terms, residual, size <= quantile(size, STATIC_SHARE))
    return cast(Floats32, np.sqrt(np.mean(residual**2, axis=0)))
