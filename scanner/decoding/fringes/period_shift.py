"""Shifts that grow as the period shortens, as when software resamples frames by a fraction of a pixel.

Linear interpolation between two pixels shifts long waves correctly, but short ones lag behind with the square of their
frequency. The fringes of one period then disagree with those of the next, smoothly over whole surfaces, as if a device
had been knocked exactly between them. The two causes cannot be distinguished.
"""

from itertools import pairwise
from math import sqrt

from calib.numerics import CUBIC
from scanner.decoding.motion import MotionFound
from scanner.decoding.sequence_plan import SequencePlan

# Jitter of single frames ripples a fringe. The part that is alike over whole surfaces is this share of the motion:
# 0.001 to 0.002 px of 0.2 to 0.3, for each polynomial, in three simulated rooms.
_LEFT_OF_SINGLE_FRAMES = 0.006


def between_periods_px(plan: SequencePlan, motion: MotionFound | None) -> float:
    """Return the smooth error left by an apparent motion between two periods or by jitter, as in
    `calib.refinement.Shifts`.

    In projector pixels; 0 if no such motion was found. An apparent motion between periods may not be a real one.
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
            # It is spread over cubic polynomials of either coordinate.
            return motion.size_px / (1 - (shorter / longer) ** 2) / sqrt(2 * CUBIC)
    return 0.0


def _places(plan: SequencePlan, period: float) -> list[int]:
    frames = {frame for fringe in plan.fringes if fringe.period == period for frame in fringe.frames}
    return [place for place, frame in enumerate(plan.shown) if frame in frames]
