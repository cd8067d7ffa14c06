"""Contradictions between frames and the light that their patterns must show, at the lit pixels of a sample."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import median
from scanner.decoding.arrays import Floats32
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.medians import medians, robust_sigmas
from scanner.decoding.sequence_plan import Fringe, SequencePlan

# Deviations from the right frame, relative to what an exchange would cause. An exchanged frame is wrong by the whole
# swing where its pattern differs, a nonlinear camera curve by less than half. N times the scatter of a fringe's mean
# over N shifts is about an amplitude if one of the N frames shows another pattern, 0.1 to 0.2 from harmonics. The
# amplitude and shift of a frame is off by a distance of 1 and more between phasors.
_WRONG = 0.5
_WRONG_SHARE = 0.05  # of the lit pixels: people and occlusion edges cover less
# If less than a third of a cycle is visible, shifts and amplitudes are not separable: limit on the ratio of singular
# values.
_MOST_UNEVEN = 2.0
# Share of the power of a fringe that its fit leaves: 0.05 for a gamma of 2.2, 0.5 for exchanged opposite or next
# shifts.
_UNEXPLAINED = 0.25
# Scatter of a fringe's frames in standard deviations of the noise; a barely visible fringe has 3.
_BLURRED_AWAY = 2.0
# Exchanged frames are named if undoing the exchange leaves at most this share of the contradictions: all but those of
# noise and of the projector's and the camera's curves.
LEFT_BY_EXCHANGE = 0.3


@dataclass(frozen=True)
class Anomaly:
    """A contradiction, with a short `message` and the suspected `frames`."""

    message: str
    frames: tuple[int, ...]


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


@dataclass(frozen=True)
class _SampledFringe:
    """One fringe at the lit pixels: `levels` (shifts, P), and the least-squares fit `offset`, `cosine`, `sine` (P,).

    `is_seen`: whether it exceeds the noise.
    """

    fringe: Fringe
    levels: Floats32
    offset: Floats32
    cosine: Floats32
    sine: Floats32
    is_seen: bool

    @property
    def amplitude(self) -> Floats32:
        """(P,)."""
        amplitude: Floats32 = np.hypot(self.cosine, self.sine)
        return amplitude


def contradictions(plan: SequencePlan, shown: LitSample) -> list[Anomaly]:
    """Return all contradictions between the frames and the sequence."""
    # A fringe that the lenses have blurred away cannot be checked.
    seen = [fringe for fringe in (_sampled_fringe(fringe, shown) for fringe in plan.fringes) if fringe.is_seen]
    return [*_extremes(plan, shown), *_complements(plan, shown), *_means(plan, shown, seen), *_shifts(plan, seen)]


def _extremes(plan: SequencePlan, shown: LitSample) -> Iterator[Anomaly]:
    for frame, side, word in ((plan.white, 1, "darker"), (plan.black, -1, "brighter")):
        if frame is None:
            continue
        excess = shown.levels - shown.levels[frame]
        beyond = excess > _WRONG * shown.swing if side > 0 else excess < -_WRONG * shown.swing
        wrong = np.mean(beyond.any(axis=0))
        if wrong > _WRONG_SHARE:
            suspect = int(np.argmax(np.count_nonzero(beyond, axis=1)))
            yield Anomaly(
                f"{plan.name(frame)} is {word} than others at {wrong:.0%} of the lit pixels, above all than "
                f"{plan.name(suspect)}",
                (frame, suspect),
            )


def _complements(plan: SequencePlan, shown: LitSample) -> Iterator[Anomaly]:
    pairs = plan.complements
    if len(pairs) < 2:
        return
    sums = np.stack([shown.levels[a] + shown.levels[b] for a, b in pairs])
    wrong = np.mean(np.abs(sums - medians(sums, axis=0)) > _WRONG * shown.swing, axis=1)
    if wrong.max() > _WRONG_SHARE:
        suspects = [frame for pair, share in zip(pairs, wrong, strict=True) for frame in pair if share > _WRONG_SHARE]
        yield Anomaly(
            f"pattern and inverse do not complement each other at {wrong.max():.0%} of the lit pixels, in "
            f"{plan.names(suspects)}",
            tuple(suspects),
        )


def _means(plan: SequencePlan, shown: LitSample, seen: Sequence[_SampledFringe]) -> Iterator[Anomaly]:
    even = [one for one in seen if one.fringe.equal_steps]
    if not even:
        return
    means = np.stack([np.mean(one.levels, axis=0) for one in even])
    reference = medians(means, axis=0) if len(even) > 1 else shown.levels.min(axis=0)
    relative_noise = median(shown.sigma / shown.swing)
    spreads = robust_sigmas((means - reference) / shown.swing)
    amplitudes = medians(np.stack([one.amplitude for one in even]) / shown.swing, axis=1)
    for one, spread, amplitude in zip(even, spreads.tolist(), amplitudes.tolist(), strict=True):
        steps = len(one.fringe.shifts)
        if steps * np.sqrt(max(spread**2 - relative_noise**2 / steps, 0.0)) > _WRONG * amplitude:
            yield Anomaly(
                f"the mean of {plan.names(one.fringe.frames)} is no even grey, as it is for a fringe in equal steps",
                one.fringe.frames,
            )


def _shifts(plan: SequencePlan, seen: Sequence[_SampledFringe]) -> Iterator[Anomaly]:
    """Yield frames whose amplitude or phase shift does not fit the fringe that all of them form together."""
    for one in seen:
        fringe, swings = one.fringe, one.levels - one.offset
        phasors = fringe.design[:, 1:].T
        components = np.stack([one.cosine, one.sine])
        unexplained = swings - phasors.T.astype(np.float32) @ components
        if np.mean(unexplained**2) > _UNEXPLAINED * np.mean(swings**2):
            yield Anomaly(f"{plan.names(fringe.frames)} make no fringe together", fringe.frames)
            continue
        components = components.astype(np.float64)
        gram = components @ components.T
        if np.linalg.cond(gram) > _MOST_UNEVEN**2:
            continue
        wrong = np.linalg.norm(np.linalg.solve(gram, components @ swings.T) - phasors, axis=0) > _WRONG
        if wrong.any():
            suspects = [frame for frame, is_wrong in zip(fringe.frames, wrong, strict=True) if is_wrong]
            message = f"{plan.names(suspects)} have another shift or period than their patterns"
            yield Anomaly(message, tuple(suspects))


def _sampled_fringe(fringe: Fringe, shown: LitSample) -> _SampledFringe:
    levels = shown.levels[list(fringe.frames)]
    offset, cosine, sine = np.tensordot(fringe.weights.astype(np.float32), levels, axes=1)
    spread = medians(np.std(levels, axis=0, ddof=1) / shown.sigma, axis=0)
    return _SampledFringe(fringe, levels, offset, cosine, sine, bool(spread > _BLURRED_AWAY))
