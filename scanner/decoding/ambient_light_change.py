"""Light that is switched on or off during the capture: from some frame on, every pixel has more of it, or less.

Unlike a lamp that flickers it adds to the frames, by an amount of its own at each pixel. It shows in the sums of pairs
and of fringes: from one on they are all off, by light of one sign. Where only the sums of fringes tell, they are
compared with black and white: their steps add up to the same grey everywhere, a part of white that is known from the
frames before.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np

from calib.numerics import Image, median
from scanner.decoding.arrays import Floats32
from scanner.decoding.sequence_plan import SequencePlan

# Of the squares of the added light, those of the other sign; noise is of both.
_MOST_OF_OTHER_SIGN = 0.1
# Switched at the right frame, it explains most contradictions; within one group of frames, any moment looks alike.
_MOST_LEFT, _AS_GOOD = 0.5, 0.8
# What two moments may leave, one of the other, if the frames do not tell them apart; of a clear one it is a fifteenth.
_ALIKE = 2.0
_NOTHING = 1e-9
# What harms no bit need not be taken out.
_LEAST_SHARE = 0.03
# By so much of white stripes that are not fine may light more than half of what is seen.
_UNEVEN = 0.1


@dataclass(frozen=True)
class AmbientLightChange:
    """From `frame` on there is more light, as much as all frames make with these `weights` (frames,); the median pixel
    has this `share` of the patterns' more, or less. `beside`: the frame next to it that explains the frames as well, as
    where the light came up while one was exposed; None if there is none.
    """

    frame: int
    weights: Floats32
    share: float = 0.0
    beside: int | None = None

    @property
    def is_harmful(self) -> bool:
        """Whether it may turn bits over that have no inverse, and bend fringes."""
        return abs(self.share) > _LEAST_SHARE

    def light(self, levels: Floats32) -> Floats32:
        """Of pixels (P,), from their levels in all frames (frames, P); in grey levels."""
        return self.weights @ levels

    def image(self, frames: Iterable[Image], shape: tuple[int, ...], plan: SequencePlan) -> Floats32:
        """The light of all pixels, from the frames of a capture in the order in which they were shown, of (H, W)."""
        light = np.zeros(shape, np.float32)
        for place, frame in enumerate(frames):
            number = plan.shown[place]
            if place == plan.shown.index(number):
                cv2.addWeighted(light, 1, frame, float(self.weights[number]), 0, dst=light, dtype=cv2.CV_32F)
        return light

    def undone(self, levels: Floats32) -> Floats32:
        """The frames (frames, P) as they would be in the first light."""
        result = levels.copy()
        result[self.frame :] -= self.light(levels)
        return result

    def said(self, plan: SequencePlan) -> str:
        """For the operator."""
        went = "on" if self.share > 0 else "off"
        when = plan.name(self.frame) if self.beside is None else f"{plan.name(self.frame)} or {plan.name(self.beside)}"
        return f"light of {abs(self.share):.0%} of the pattern's was switched {went} before {when}"


def without_light(
    frames: Iterable[Image], light: Floats32, plan: SequencePlan, switch: AmbientLightChange
) -> Iterator[Image]:
    """The frames (N, H, W) of a capture, one by one, as they would be in the first light; `light` (H, W): the other."""
    begin = plan.shown.index(switch.frame)
    for place, frame in enumerate(frames):
        depth = cv2.CV_8U if frame.dtype == np.uint8 else cv2.CV_16U
        yield frame if place < begin else cast(Image, cv2.subtract(frame, light, dtype=depth))


def may_be_switched(plan: SequencePlan, levels: Floats32) -> bool:
    """Whether the means over all pixels (frames, P) of a fringe's steps differ, of which pixels see all phases; or that
    of fine stripes is not the half of white that they light.
    """
    if _spread_of_steps(plan, levels) > _LEAST_SHARE:
        return True
    means = levels.mean(axis=1)
    if plan.white is None or plan.black is None:
        return False
    parts = (means - means[plan.black]) / max(means[plan.white] - means[plan.black], _NOTHING)
    return any(abs(parts[frame] - 0.5) > _UNEVEN for frame in _fine(plan, 0))


def light_switch(
    plan: SequencePlan, levels: Floats32, swing: Floats32, contradiction: Callable[[Floats32], float]
) -> AmbientLightChange | None:
    """The one that explains most of what is contradictory about the `levels` (frames, P); None if none does.

    `swing` (P,): how far the levels of a pixel are apart. `contradiction` measures frames (frames, P).
    """
    weighted = [
        (frame, *found) for frame in range(1, len(levels)) if (found := _light_weights(plan, levels, frame)) is not None
    ]
    if not weighted:
        return None
    explained = np.array([precision * np.mean((of_light @ levels / swing) ** 2) for _, of_light, precision in weighted])
    candidates = [
        AmbientLightChange(frame, of_light, median(of_light @ levels / swing))
        for (frame, of_light, _), much in zip(weighted, explained, strict=True)
        if much >= _AS_GOOD * explained.max()
    ]
    candidates = [candidate for candidate in candidates if _is_of_one_sign(candidate.light(levels) / swing)]
    if not candidates:
        return None
    left = [contradiction(candidate.undone(levels)) for candidate in candidates]
    least, best, before = min(left), candidates[int(np.argmin(left))], contradiction(levels)
    # Steps half of which are in either light contradict each other little, but differ from their mean.
    is_even = _spread_of_steps(plan, best.undone(levels)) <= _MOST_LEFT * _spread_of_steps(plan, levels)
    near = [c.frame for c, rest in zip(candidates, left, strict=True) if rest <= _ALIKE * least]
    best = replace(best, beside=next((frame for frame in near if abs(frame - best.frame) == 1), None))
    return best if least <= _MOST_LEFT * before or (least < before and is_even) else None


def _spread_of_steps(plan: SequencePlan, levels: Floats32) -> float:
    means = levels.mean(axis=1)
    steps = [float(np.ptp(means[list(fringe.frames)])) for fringe in plan.fringes]
    return max(steps, default=0.0) / max(float(np.ptp(means)), _NOTHING)


def _light_weights(plan: SequencePlan, levels: Floats32, frame: int) -> tuple[Floats32, float] | None:
    """With what weights (frames,) all frames make the light that was switched before one of them, by least squares in
    the means of pairs and fringes, and its precision; None if these do not tell.
    """
    of_means, after = [], []
    for frames_of, base in _bases(plan, levels, frame):
        groups = np.zeros((len(frames_of), len(levels)), np.float32)
        for group, frames in zip(groups, frames_of, strict=True):
            group[list(frames)] = 1 / len(frames)
        of_means.append(groups - (groups.mean(axis=0) if base is None else base))
        share = groups[:, frame:].sum(axis=1)
        after.append(share - share.mean() if base is None else share)
    shares = np.concatenate(after) if after else np.zeros(0)
    precision = float(shares @ shares)
    return ((shares / precision) @ np.concatenate(of_means), precision) if precision > _NOTHING else None


def _bases(
    plan: SequencePlan, levels: Floats32, frame: int
) -> Iterator[tuple[Sequence[Sequence[int]], Floats32 | None]]:
    """Groups of frames that have the same mean in one light, and the weights (frames,) of all frames in that; None if
    only the other groups tell it.
    """
    fringes = [fringe.frames for fringe in plan.fringes if fringe.equal_steps]
    if len(plan.complements) > 1:
        yield plan.complements, None
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
    """The mean of fringes as a part of white: by those before a frame, of which pixels see all phases; or else by what
    fine stripes after it, of which half are lit, have more than half of white. None if there are no such frames.
    """
    white, black = levels[plan.white].mean(), levels[plan.black].mean()
    parts = (levels.mean(axis=1) - black) / max(white - black, _NOTHING)
    of_fringes = np.array([number for frames in fringes for number in frames])
    if np.any(of_fringes < frame):
        return float(parts[of_fringes[of_fringes < frame]].mean())
    fine = _fine(plan, frame)
    return float(parts[of_fringes].mean() - (parts[fine].mean() - 0.5)) if fine else None


def _fine(plan: SequencePlan, frame: int) -> list[int]:
    """Of each code the finest bit without an inverse from a frame on."""
    later = [{bit: number for bit, number in code.unpaired.items() if number >= frame} for code in plan.codes]
    return [numbers[max(numbers)] for numbers in later if numbers]


def _is_of_one_sign(light: Floats32) -> bool:
    brighter, darker = (float(np.sum(np.maximum(sign * light, 0) ** 2)) for sign in (1, -1))
    return min(brighter, darker) <= _MOST_OF_OTHER_SIGN * max(brighter, darker)
