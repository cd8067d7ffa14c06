"""Contradictions between frames and the light that their patterns must show, at the lit pixels of a sample.

White is the brightest of all frames and black the darkest, pattern and inverse add up to the same light, the steps of a
fringe lie on a cosine, and all fringes have the same mean. What a frame misses of this is its residual.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats32, median, medians, robust_sigmas
from scanner.decoding.light import NoiseModel
from scanner.decoding.sequence_plan import Fringe, SequencePlan
from scanner.decoding.significance import HALF, HUBER_SIGMAS

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
