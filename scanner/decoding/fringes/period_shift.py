"""Fringes that a filter shifts, by more the shorter they are: frames that software has moved by a part of a pixel.

Between two pixels such software takes their weighted mean, which is a shift for long waves only; short ones lag behind,
with the square of their frequency. The fringes of one period then disagree with those of the next, smoothly over whole
faces, as if a device had been knocked against just between them. Which of the two it was cannot be told.
"""

from itertools import pairwise
from math import sqrt

from scanner.decoding.motion import MotionFound
from scanner.decoding.sequence_plan import SequencePlan

# The polynomials up to the cubic ones, of either coordinate, share what is seen.
_MODES = 20
# Frames that are each somewhere else ripple a fringe, and what of it is alike over whole faces is this part of the
# coordinates' motion: 0.001 to 0.002 px of 0.2 to 0.3, of each polynomial, in three simulated rooms.
_LEFT_OF_SINGLE_FRAMES = 0.006


def between_periods_px(plan: SequencePlan, motion: MotionFound | None) -> float:
    """What coordinates may err smoothly if a motion was seen between fringes of two periods, and was none, or if each
    frame was somewhere else, as of `calib.refinement.Shifts`; 0 if none was seen.
    """
    if motion is None or not motion.significant or motion.slow:
        return 0.0
    if motion.one_by_one:
        return _LEFT_OF_SINGLE_FRAMES * motion.size_px
    periods = sorted({fringe.period for fringe in plan.fringes}, reverse=True)
    for longer, shorter in pairwise(periods):
        before = [place for place in _places(plan, longer) if place >= motion.last / plan.repeats]
        after = [place for place in _places(plan, shorter) if place <= motion.first / plan.repeats]
        if not before and not after:
            return motion.size_px / (1 - (shorter / longer) ** 2) / sqrt(_MODES)
    return 0.0


def _places(plan: SequencePlan, period: float) -> list[int]:
    frames = {frame for fringe in plan.fringes if fringe.period == period for frame in fringe.frames}
    return [place for place, frame in enumerate(plan.shown) if frame in frames]
