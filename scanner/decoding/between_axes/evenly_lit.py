"""Two pictures of the evenly lit scene, one from all patterns along each axis.

The mean of a fringe over its shifts, and that of a pattern and its inverse, equal half of white, whatever the pattern.
All patterns along x together thus give one picture of the scene, those along y another. They are compared if all of one
axis is shown before all of the other, since no fringe observes a motion in between.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from calib.numerics import Floats32, Image
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan


@dataclass(frozen=True)
class Half:
    """The frames that measure an axis."""

    axis: AxisPlan
    """Which."""
    first: int
    """Place of the first of them in the capture."""
    last: int
    """Place of the last."""
    weights: dict[int, float]
    """Of frames in the mean picture, by number; empty if no frames add up to even light."""


def halves_of(plan: SequencePlan) -> tuple[Half, Half] | None:
    """Return the two halves of a capture in order of time; None unless one axis is measured before the other."""
    if not all(axis.is_measured for axis in plan.axes):
        return None
    first, second = sorted((_half(plan, axis) for axis in plan.axes), key=lambda half: half.first)
    return (first, second) if first.last < second.first else None


def _half(plan: SequencePlan, axis: AxisPlan) -> Half:
    frames = {frame for fringe in axis.fringes for frame in fringe.frames}
    # With fringes, codes only select the period.
    frames = frames or {frame for code in axis.codes for frame in code.frames}
    places = [place for place, frame in enumerate(plan.shown) if frame in frames]
    return Half(axis, min(places), max(places), _weights(axis))


def _weights(axis: AxisPlan) -> dict[int, float]:
    weights: dict[int, float] = {}
    groups = [dict(zip(fringe.frames, fringe.weights[0].tolist(), strict=True)) for fringe in axis.fringes] or [
        dict.fromkeys(pair, 0.5) for pair in dict.fromkeys(pair for code in axis.codes for pair in code.pairs.values())
    ]
    for group in groups:
        for frame, weight in group.items():
            weights[frame] = weights.get(frame, 0.0) + weight / len(groups)
    return weights


def pairs_of(axis: AxisPlan) -> dict[int, tuple[int, int]]:
    """Return bit → frames of pattern and inverse, if a Gray code alone gives the coordinate."""
    return axis.codes[0].pairs if len(axis.codes) == 1 and not axis.fringes else {}


@dataclass(frozen=True)
class EvenlyLit:
    """The two `pictures` of the scene, (H, W) each.

    `of_pairs` (H, W): means of pattern and inverse, for codes alone, in order of display. If pattern and inverse differ
    in brightness, stripes remain, which move with neither device.
    """

    halves: tuple[Half, Half]
    pictures: tuple[Floats32, Floats32]
    of_pairs: dict[tuple[int, int], Image]

    def pictures_of(self, before: Sequence[int], after: Sequence[int]) -> tuple[Floats32, Floats32]:
        """Return the mean pictures (H, W) of two groups of pairs, given by number."""
        of_pairs = [*self.of_pairs.values()]
        return _mean([of_pairs[k] for k in before]), _mean([of_pairs[k] for k in after])


def evenly_lit(halves: tuple[Half, Half], frames: Iterable[tuple[int, Image]], shape: tuple[int, int]) -> EvenlyLit:
    """Add up the frames (H, W) of a capture, by index, that belong to a half."""
    pictures = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    of_pairs: dict[tuple[int, int], Image] = {}
    pair_of = {frame: pair for half in halves for pair in pairs_of(half.axis).values() for frame in pair}
    for number, grey in frames:
        for half, picture in zip(halves, pictures, strict=True):
            if weight := half.weights.get(number):
                cv2.addWeighted(picture, 1, grey, weight, 0, dst=picture, dtype=cv2.CV_32F)
        if (pair := pair_of.get(number)) is not None:
            previous = of_pairs.get(pair)
            of_pairs[pair] = grey if previous is None else cast(Image, cv2.addWeighted(previous, 0.5, grey, 0.5, 0))
    return EvenlyLit(halves, pictures, of_pairs)


def _mean(pictures: Sequence[Image]) -> Floats32:
    total = np.zeros(pictures[0].shape, np.float32)
    for picture in pictures:
        cv2.accumulate(picture, total)
    total /= len(pictures)
    return total
