"""Ambient light that is switched on or off during the capture: from some frame on, it adds to every pixel.

Unlike flicker it is additive, with a different amount at each pixel. It shows in the sums of pairs and of fringes: from
one frame on they all deviate with the same sign. If only fringes tell, their sums are compared with black and white:
their mean is the same share of white everywhere, known from the frames before the change.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats32, Image, median, medians
from scanner.decoding.light.constraints import ConstraintSet, LitSample
from scanner.decoding.light.samples import PartOfFrames
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import AS_GOOD, FEW, HALF, NEGLIGIBLE

# Smaller changes invert no bit and are not removed.
_LEAST_SHARE = 0.03


@dataclass(frozen=True)
class AmbientLightChange:
    """An ambient light change."""

    frame: int
    """The first frame after it."""
    weights: Floats32
    """(frames,): the linear combination of all frames that gives the added light."""
    share: float = 0.0
    """Of the added light at the median pixel, relative to the pattern's; negative if switched off."""
    beside: int | None = None
    """An adjacent frame that explains the frames as well, as when the light came up during an exposure; None for none.

    """

    @property
    def is_harmful(self) -> bool:
        """Whether it may invert bits without an inverse, and distort fringes."""
        return abs(self.share) > _LEAST_SHARE

    def light(self, levels: Floats32) -> Floats32:
        """Return the added light of pixels (P,) in grey levels, from their levels in all frames (frames, P)."""
        return self.weights @ levels

    def undone(self, levels: Floats32) -> Floats32:
        """Return the frames (frames, P) without the change."""
        result = levels.copy()
        result[self.frame :] -= self.light(levels)
        return result

    def apply(self, frames: PartOfFrames, places: Sequence[int]) -> Iterator[Image]:
        """Yield the frames (...) at some places without the change, from two readings of all of them."""
        plan, every = frames.plan, range(len(frames.plan.shown))
        light: NDArray[Any] | None = None
        for place, frame in enumerate(frames.read(every)):
            number = plan.shown[place]
            if place == plan.shown.index(number):
                total, kept = (frame, 0) if light is None else (light, 1)
                weight = float(self.weights[number])
                light = cv2.addWeighted(total, kept, frame, weight, 0, dtype=cv2.CV_32F).reshape(frame.shape)
        begin = plan.shown.index(self.frame)
        for place, frame in enumerate(frames.read(every)):
            depth = cv2.CV_8U if frame.dtype == np.uint8 else cv2.CV_16U
            if light is not None and place >= begin:
                frame = cast(Image, cv2.subtract(frame, light, dtype=depth)).reshape(frame.shape)
            if place in places:
                yield frame

    def description(self, plan: SequencePlan) -> str:
        """Return a clause for the operator."""
        direction = "on" if self.share > 0 else "off"
        when = plan.name(self.frame) if self.beside is None else f"{plan.name(self.frame)} or {plan.name(self.beside)}"
        return f"light of {abs(self.share):.0%} of the pattern's was switched {direction} before {when}"


def may_be_switched(plan: SequencePlan, levels: Floats32) -> bool:
    """Whether mean levels (frames, P) hint at an ambient light change.

    Either the means of a fringe's steps differ, over pixels that see all phases; or those of fine stripes are not half
    of white.
    """
    if _spread_of_steps(plan, levels) > _LEAST_SHARE:
        return True
    means = levels.mean(axis=1)
    if plan.white is None or plan.black is None:
        return False
    parts = (means - means[plan.black]) / max(means[plan.white] - means[plan.black], NEGLIGIBLE)
    # Stripes that are not fine may light a few more than half of the visible pixels.
    return any(abs(parts[frame] - 0.5) > FEW for frame in _fine(plan, 0))


def is_suspected(constraints: ConstraintSet, levels: Floats32) -> bool:
    """Whether some lit pixels, `levels` (frames, P), look as by a harmful change of the ambient light before any of the
    frames; a fast test.
    """
    every = (_light_weights(constraints, levels, frame) for frame in range(1, len(levels)))
    weights = [of_light for of_light, _ in filter(None, every)]
    if not weights:
        return False
    shares = medians(np.stack(weights) @ levels / np.ptp(levels, axis=0), axis=1)
    return bool(np.abs(shares).max() > _LEAST_SHARE)


def light_switch(sample: LitSample) -> AmbientLightChange | None:
    """Return the ambient light change that explains most of the contradictions of a sample; None if none does."""
    plan, levels, swing = sample.constraints.plan, sample.levels, sample.swing
    weighted = [
        (frame, *weights)
        for frame in range(1, len(levels))
        if (weights := _light_weights(sample.constraints, levels, frame)) is not None
    ]
    if not weighted:
        return None
    explained = np.array([precision * np.mean((of_light @ levels / swing) ** 2) for _, of_light, precision in weighted])
    candidates = [
        AmbientLightChange(frame, of_light, median(of_light @ levels / swing))
        for (frame, of_light, _), much in zip(weighted, explained, strict=True)
        if much >= AS_GOOD * explained.max()  # within one group of frames all moments look alike
    ]
    candidates = [candidate for candidate in candidates if _is_of_one_sign(candidate.light(levels) / swing)]
    if not candidates:
        return None
    remaining = [sample.by(candidate.undone(levels)).inconsistency for candidate in candidates]
    least, best = min(remaining), candidates[int(np.argmin(remaining))]
    # A change in the middle of a fringe's steps causes little contradiction, but changes the means of the steps.
    is_even = _spread_of_steps(plan, best.undone(levels)) <= HALF * _spread_of_steps(plan, levels)
    # A clear moment leaves a fifteenth of what others do.
    near = [c.frame for c, rest in zip(candidates, remaining, strict=True) if AS_GOOD * rest <= least]
    best = replace(best, beside=next((frame for frame in near if abs(frame - best.frame) == 1), None))
    before = sample.inconsistency
    return best if least <= HALF * before or (least < before and is_even) else None


def _spread_of_steps(plan: SequencePlan, levels: Floats32) -> float:
    means = levels.mean(axis=1)
    steps = [float(np.ptp(means[list(fringe.frames)])) for fringe in plan.fringes]
    return max(steps, default=0.0) / max(float(np.ptp(means)), NEGLIGIBLE)


def _light_weights(constraints: ConstraintSet, levels: Floats32, frame: int) -> tuple[Floats32, float] | None:
    """Return the weights (frames,) of all frames that give the light switched before `frame`, and their precision.

    By least squares in the means of pairs and fringes; None if these do not determine it.
    """
    of_means, after = [], []
    for frames_of, base in _bases(constraints, levels, frame):
        groups = np.zeros((len(frames_of), len(levels)), np.float32)
        for group, frames in zip(groups, frames_of, strict=True):
            group[list(frames)] = 1 / len(frames)
        of_means.append(groups - (groups.mean(axis=0) if base is None else base))
        share = groups[:, frame:].sum(axis=1)
        after.append(share - share.mean() if base is None else share)
    shares = np.concatenate(after) if after else np.zeros(0)
    precision = float(shares @ shares)
    return ((shares / precision) @ np.concatenate(of_means), precision) if precision > NEGLIGIBLE else None


def _bases(
    constraints: ConstraintSet, levels: Floats32, frame: int
) -> Iterator[tuple[Sequence[Sequence[int]], Floats32 | None]]:
    """Yield groups of frames of equal mean in constant light, and that mean as weights (frames,) of all frames.

    The weights are None if only the other groups determine the mean.
    """
    plan, fringes = constraints.plan, [fringe.frames for fringe in constraints.even]
    if len(constraints.pairs) > 1:
        yield constraints.pairs, None
    elif fringes and plan.white is not None and plan.black is not None and frame > max(plan.white, plan.black):
        grey = _grey_of(plan, fringes, levels, frame)
        if grey is not None:
            base = np.zeros(len(levels), np.float32)
            base[[plan.white, plan.black]] = grey, 1 - grey
            yield fringes, base
        return
    if len(fringes) > 1:
        yield fringes, None


def _grey_of(plan: SequencePlan, fringes: Sequence[Sequence[int]], levels: Floats32, frame: int) -> float | None:
    """Return the mean of fringes as a share of white; None if it cannot be determined.

    From the fringe frames before `frame`, or else from the excess of the fine stripes after it over half of white.
    """
    white, black = levels[plan.white].mean(), levels[plan.black].mean()
    parts = (levels.mean(axis=1) - black) / max(white - black, NEGLIGIBLE)
    of_fringes = np.array([number for frames in fringes for number in frames])
    if np.any(of_fringes < frame):
        return float(parts[of_fringes[of_fringes < frame]].mean())
    fine = _fine(plan, frame)
    return float(parts[of_fringes].mean() - (parts[fine].mean() - 0.5)) if fine else None


def _fine(plan: SequencePlan, frame: int) -> list[int]:
    """Return, for each code, the finest bit without an inverse from a frame on."""
    later = [{bit: number for bit, number in code.unpaired.items() if number >= frame} for code in plan.codes]
    return [numbers[max(numbers)] for numbers in later if numbers]


def _is_of_one_sign(light: Floats32) -> bool:
    """Return whether hardly any of the squared light (P,) is of the other sign; noise has both signs."""
    brighter, darker = (float(np.sum(np.maximum(sign * light, 0) ** 2)) for sign in (1, -1))
    return min(brighter, darker) <= FEW * max(brighter, darker)
