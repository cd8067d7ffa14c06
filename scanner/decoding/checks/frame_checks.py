"""Check that each frame shows the pattern that the capture states, on a sample of all frames before decoding.

Light adds up: white is the brightest of all frames and black the darkest, pattern and inverse add up to white plus
black, and the mean of a fringe over its shifts is the same grey everywhere. This holds under any interreflection and
any brightness curve of the projector. Exchanged, duplicated or foreign frames break it; so do passing people and some
devices. An exchange is proven by exchanging the frames back, a duplicate by the identical frame. Everything else is an
anomaly that is assessed later by the coordinates.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from calib.numerics import TRIAL_PIXELS, Bools, Floats32, evenly_spread
from scanner.decoding.ambient_light_change import AmbientLightChange, light_switch, may_be_switched
from scanner.decoding.checks.frame_consistency import (
    LEFT_BY_EXCHANGE,
    Anomaly,
    LitSample,
    contradictions,
    total_contradiction,
)
from scanner.decoding.light import NoiseModel
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import AS_GOOD, FEWEST_PIXELS, HALF, NEARLY_ALL, OUTLYING_SIGMAS
from scanner.errors import InputError

# Least swing of a lit pixel over all frames: in standard deviations of a difference of two, of which a hundred frames
# have thousands, and in grey levels, which rounding alone may differ by. Better pixels are preferred.
_SEEN, _WELL_SEEN, _LEAST_SWING = 8.0, 20.0, 2.0
_FEWEST_LIT = 20  # of the sample: in the fewest pixels that can be decoded at all, 0.1 % of the picture
# Each misplaced frame adds the square of its difference from the right one to the contradictions, twice that if only
# one other frame contradicts it. Undoing an exchange must remove at least this part.
# It is rejected if another exchange of either frame leaves hardly more: if black was taken in brighter light, for
# example, any dark frame in its place helps as much.
_DIFFERENT = 0.02  # least mean squared difference of exchanged frames, in swings: less does no harm
# Flicker and automatic exposure change white by less than this factor.
_MOST_BRIGHTER = 4.0


def check_frames(
    plan: SequencePlan, levels: Floats32, alike: Floats32, noise: NoiseModel, saturation: float
) -> tuple[list[Anomaly], AmbientLightChange | None]:
    """Return the anomalies of the sample `levels` (frames, P), and an ambient light change if there was one.

    `alike`: the levels after equalising brightness, which resolves some contradictions.

    Raises InputError if nothing is lit, or if frames were certainly exchanged or duplicated.
    """
    lit = _lit(levels, noise, saturation)
    shown = LitSample.of(levels[:, lit], noise)
    made_alike = replace(shown, levels=alike[:, lit])
    found = contradictions(plan, shown)
    if not found and not may_be_switched(plan, shown.levels):
        return [], None
    made_alike, switch = _in_one_light(plan, shown, made_alike)
    made_alike = _with_brighter_white(plan, made_alike)
    if not found and switch is None:
        return [], None
    switched = [] if switch is None else [Anomaly(switch.description(plan), (switch.frame,))]
    mistake = _exchange(plan, shown, made_alike, found) or _duplicate(plan, shown, found)
    if mistake:
        message = "; ".join([*(anomaly.message for anomaly in found), mistake])
        raise InputError(f"the frames do not show what the capture says: {message}")
    return [*switched, *contradictions(plan, made_alike)], switch


def agree(plan: SequencePlan, levels: Floats32, noise: NoiseModel, saturation: float) -> bool:
    """Return whether enough pixels of the sample (frames, P) are lit, and nothing in them contradicts the sequence."""
    lit = _seen(LitSample.of(levels, noise)) & (levels.max(axis=0) < saturation)
    return int(np.count_nonzero(lit)) >= FEWEST_PIXELS and not contradictions(plan, LitSample.of(levels[:, lit], noise))


def an_exchange_explains(plan: SequencePlan, levels: Floats32, suspects: Sequence[int]) -> bool:
    """Return whether exchanging two frames, one a suspect, removes most contradictions in the sample (frames, P)."""
    swing = np.ptp(levels, axis=0)
    lit = evenly_spread(np.flatnonzero(swing > _LEAST_SWING), TRIAL_PIXELS)
    seen, swing = levels[:, lit], swing[lit]
    if not len(lit):
        return False
    most = LEFT_BY_EXCHANGE * total_contradiction(plan, seen, swing)
    return any(left < most for _, _, left in _exchanges(plan, seen, swing, suspects))


def _exchanges(
    plan: SequencePlan, levels: Floats32, swing: Floats32, suspects: Sequence[int]
) -> Iterator[tuple[tuple[int, int], float, float]]:
    """Yield pairs of frames that differ, one a suspect, with their mean squared difference in swings (P,), and the
    total contradiction of `levels` (frames, P) once they are exchanged.
    """
    for first in suspects:
        for second in range(len(levels)):
            differ = float(np.mean(((levels[first] - levels[second]) / swing) ** 2))
            if differ >= _DIFFERENT and not (second in suspects and second < first):
                order = np.arange(len(levels))
                order[[first, second]] = second, first
                yield (first, second), differ, total_contradiction(plan, levels[order], swing)


def _in_one_light(
    plan: SequencePlan, shown: LitSample, alike: LitSample
) -> tuple[LitSample, AmbientLightChange | None]:
    """Remove an ambient light change, from the equalised frames or the original ones, whichever is more consistent.

    There was none if the equalised frames are consistent, as a darker step of a fringe looks like light at the opposite
    one. Nor if lamps flicker and the unknown gain of white alone explains the frames about as well.
    """

    def is_consistent(one: LitSample) -> bool:
        return not contradictions(plan, one) and not may_be_switched(plan, one.levels)

    def left(levels: Floats32) -> float:
        return total_contradiction(plan, levels, shown.swing)

    best: tuple[LitSample, AmbientLightChange | None] = alike, None
    if is_consistent(alike):
        return best
    for one in (alike, shown):
        switch = None if is_consistent(one) else light_switch(plan, one.levels, one.swing, left)
        if switch is not None:
            without = replace(one, levels=switch.undone(one.levels))
            best = min(best, (without, switch), key=lambda each: left(each[0].levels))
    flickers = not np.array_equal(alike.levels, shown.levels)
    if best[1] is None or plan.white is None or not flickers:
        return best
    flickered = _with_white(plan, plan.white, alike, 1 / _MOST_BRIGHTER)
    return (alike, None) if left(flickered.levels) <= left(best[0].levels) else best


def _with_brighter_white(plan: SequencePlan, alike: LitSample) -> LitSample:
    """Return the frames with white brightened to be most consistent, if that helps much.

    The exposure of white is unknown, except that white is brightest: devices with automatic exposure record it too
    dark.
    """
    if plan.white is None:
        return alike
    brighter = _with_white(plan, plan.white, alike, 1)
    left = [total_contradiction(plan, one.levels, alike.swing) for one in (brighter, alike)]
    return brighter if left[0] < HALF * left[1] else alike


def _with_white(plan: SequencePlan, white: int, alike: LitSample, least: float) -> LitSample:
    """Return the frames with white scaled by `least` or more to be most consistent."""

    def times(factor: float) -> Floats32:
        levels = alike.levels.copy()
        levels[white] *= np.float32(factor)
        return levels

    def left(factor: float) -> float:
        return total_contradiction(plan, times(factor), alike.swing)

    found = minimize_scalar(left, bounds=(least, _MOST_BRIGHTER), method="bounded", options={"xatol": 0.01})
    return replace(alike, levels=times(float(found.x)))


def _exchange(plan: SequencePlan, shown: LitSample, alike: LitSample, found: Sequence[Anomaly]) -> str:
    """Return a message that names two exchanged frames, or ''.

    Exchanging them back must reduce the contradictions in proportion to their difference. They are not named if
    equalised brightness explains as much, or if another exchange of one of them does nearly as well.
    """
    levels, swing, of_alike = (evenly_spread(n, TRIAL_PIXELS, -1) for n in (shown.levels, shown.swing, alike.levels))
    suspects = sorted({frame for anomaly in found for frame in anomaly.frames})
    before = total_contradiction(plan, levels, swing)
    least, pair = total_contradiction(plan, of_alike, swing), (0, 0)
    tried: dict[tuple[int, int], float] = {}
    for exchange, differ, left in _exchanges(plan, levels, swing, suspects):
        tried[exchange] = left
        if before - left > HALF * differ and left < least:
            least, pair = left, exchange
    others = [left for exchange, left in tried.items() if len({*exchange, *pair}) == 3]  # one frame in common
    if pair not in tried or tried[pair] > max(LEFT_BY_EXCHANGE * before, AS_GOOD * min(others, default=before)):
        return ""
    return f"with {plan.names(pair)} exchanged they do"


def _duplicate(plan: SequencePlan, shown: LitSample, found: Sequence[Anomaly]) -> str:
    """Return a message that names a suspected frame and its duplicate, or ''."""
    for frame in sorted({frame for anomaly in found for frame in anomaly.frames}):
        alike = np.abs(shown.levels - shown.levels[frame]) < OUTLYING_SIGMAS * np.sqrt(2) * shown.sigma
        share = np.mean(alike, axis=1)
        for twin in np.flatnonzero(share > NEARLY_ALL).tolist():
            if not plan.shows_the_same(frame, twin):
                return f"{plan.names((frame, twin))} show the same"
    return ""


def _seen(sample: LitSample, sigmas: float = _SEEN) -> Bools:
    """Return the pixels (P,) of a sample that change with the patterns."""
    seen: Bools = (sample.swing > sigmas * np.sqrt(2) * sample.sigma) & (sample.swing > _LEAST_SWING)
    return seen


def _lit(levels: Floats32, noise: NoiseModel, saturation: float) -> NDArray[np.intp]:
    """Return some pixels of `levels` (frames, P) that the patterns light. Raises InputError if there are too few."""
    sample = LitSample.of(levels, noise)
    seen = _seen(sample)
    if np.count_nonzero(seen) < _FEWEST_LIT:
        raise InputError(
            "no pixel changes clearly with the patterns: half of them vary by at most "
            f"{np.median(sample.swing):.1f} grey levels over the capture, where noise is "
            f"{np.median(sample.sigma):.1f}; is the projector on, the lens uncapped, the exposure long enough?"
        )
    lit = np.flatnonzero(seen & (levels.max(axis=0) < saturation))
    if len(lit) < _FEWEST_LIT:
        raise InputError("the frames are overexposed: all lit pixels reach the largest value; shorten the exposure")
    well_lit = lit[_seen(sample, _WELL_SEEN)[lit]]
    return evenly_spread(well_lit if len(well_lit) >= FEWEST_PIXELS else lit)
