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
import scipy
from numpy.typing import NDArray

from calib.finding import Finding
from calib.numerics import TRIAL_PIXELS, Bools, Floats32, evenly_spread
from scanner.decoding.light.ambient_light_change import AmbientLightChange, light_switch, may_be_switched
from scanner.decoding.light.exposures import LIT
from scanner.decoding.light.photometric_constraints import (
    LEFT_BY_SWAP,
    LitSample,
    anomaly,
    find_anomalies,
    suspected,
    total_inconsistency,
)
from scanner.decoding.light.samples import NoiseModel
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import AS_GOOD, BRIGHTEST, FEWEST_PIXELS, HALF, NEARLY_ALL, OUTLYING_SIGMAS
from scanner.errors import FramesError, InputError

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
    plan: SequencePlan, levels: Floats32, equalised: Floats32, noise: NoiseModel, saturation: float
) -> tuple[list[Finding], AmbientLightChange | None]:
    """Return the anomalies of the sample `levels` (frames, P), and an ambient light change if there was one.

    `equalised`: the levels after equalising brightness, which resolves some contradictions.

    Raises InputError if nothing is lit, or if frames were certainly exchanged or duplicated.
    """
    lit = _lit(levels, noise, saturation)
    sample = LitSample.of(levels[:, lit], noise)
    equalised_sample = replace(sample, levels=equalised[:, lit])
    anomalies = find_anomalies(plan, sample)
    if not anomalies and not may_be_switched(plan, sample.levels):
        return [], None
    equalised_sample, switch = _in_one_light(plan, sample, equalised_sample)
    equalised_sample = _with_brighter_white(plan, equalised_sample)
    if not anomalies and switch is None:
        return [], None
    switched = [] if switch is None else [anomaly(switch.description(plan), [switch.frame])]
    mistake = _find_swap(plan, sample, equalised_sample, anomalies) or _duplicate(plan, sample, anomalies)
    if mistake:
        first, *further = [*(finding.message for finding in anomalies), mistake]
        problem = f"the frames do not show what the capture says: {first}"
        raise FramesError(problem, "; ".join(further)) if further else InputError(problem)
    return [*switched, *find_anomalies(plan, equalised_sample)], switch


def agree(plan: SequencePlan, levels: Floats32, noise: NoiseModel, saturation: float) -> bool:
    """Return whether enough pixels of the sample (frames, P) are lit, and nothing in them contradicts the sequence."""
    lit = _seen(LitSample.of(levels, noise)) & (levels.max(axis=0) < saturation)
    return int(np.count_nonzero(lit)) >= FEWEST_PIXELS and not find_anomalies(plan, LitSample.of(levels[:, lit], noise))


def is_explained_by_swap(plan: SequencePlan, levels: Floats32, suspects: Sequence[int]) -> bool:
    """Return whether exchanging two frames, one a suspect, removes most contradictions in the sample (frames, P)."""
    swing = np.ptp(levels, axis=0)
    lit = evenly_spread(np.flatnonzero(swing > _LEAST_SWING), TRIAL_PIXELS)
    lit_levels, swing = levels[:, lit], swing[lit]
    if not len(lit):
        return False
    most = LEFT_BY_SWAP * total_inconsistency(plan, lit_levels, swing)
    return any(remaining < most for _, _, remaining in _swaps(plan, lit_levels, swing, suspects))


def _swaps(
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
                yield (first, second), differ, total_inconsistency(plan, levels[order], swing)


def _in_one_light(
    plan: SequencePlan, sample: LitSample, equalised: LitSample
) -> tuple[LitSample, AmbientLightChange | None]:
    """Remove an ambient light change, from the equalised frames or the original ones, whichever is more consistent.

    There was none if the equalised frames are consistent, as a darker step of a fringe looks like light at the opposite
    one. Nor if lamps flicker and the unknown gain of white alone explains the frames about as well.
    """

    def is_consistent(frames: LitSample) -> bool:
        return not find_anomalies(plan, frames) and not may_be_switched(plan, frames.levels)

    def inconsistency(levels: Floats32) -> float:
        return total_inconsistency(plan, levels, sample.swing)

    best: tuple[LitSample, AmbientLightChange | None] = equalised, None
    if is_consistent(equalised):
        return best
    for frames in (equalised, sample):
        switch = None if is_consistent(frames) else light_switch(plan, frames.levels, frames.swing, inconsistency)
        if switch is not None:
            without = replace(frames, levels=switch.undone(frames.levels))
            best = min(best, (without, switch), key=lambda choice: inconsistency(choice[0].levels))
    flickers = not np.array_equal(equalised.levels, sample.levels)
    if best[1] is None or plan.white is None or not flickers:
        return best
    flickered = _with_white(plan, plan.white, equalised, 1 / _MOST_BRIGHTER)
    return (equalised, None) if inconsistency(flickered.levels) <= inconsistency(best[0].levels) else best


def _with_brighter_white(plan: SequencePlan, equalised: LitSample) -> LitSample:
    """Return the frames with white brightened to be most consistent, if that helps much.

    The exposure of white is unknown, except that white is brightest: devices with automatic exposure record it too
    dark.
    """
    if plan.white is None:
        return equalised
    brighter = _with_white(plan, plan.white, equalised, 1)
    remaining = [total_inconsistency(plan, frames.levels, equalised.swing) for frames in (brighter, equalised)]
    return brighter if remaining[0] < HALF * remaining[1] else equalised


def _with_white(plan: SequencePlan, white: int, equalised: LitSample, least: float) -> LitSample:
    """Return the frames with white scaled by `least` or more to be most consistent."""

    def times(factor: float) -> Floats32:
        levels = equalised.levels.copy()
        levels[white] *= np.float32(factor)
        return levels

    def inconsistency(factor: float) -> float:
        return total_inconsistency(plan, times(factor), equalised.swing)

    optimum = scipy.optimize.minimize_scalar(
        inconsistency, bounds=(least, _MOST_BRIGHTER), method="bounded", options={"xatol": 0.01}
    )
    return replace(equalised, levels=times(float(optimum.x)))


def _find_swap(plan: SequencePlan, sample: LitSample, equalised: LitSample, anomalies: Sequence[Finding]) -> str:
    """Return a message that names two exchanged frames, or ''.

    Exchanging them back must reduce the contradictions in proportion to their difference. They are not named if
    equalised brightness explains as much, or if another exchange of one of them does nearly as well.
    """
    # Beside the picture frames differ by their exposures alone, which any dark frame in the place of black explains.
    lit = sample.swing >= LIT * np.quantile(sample.swing, BRIGHTEST)
    levels, swing, of_equalised = (
        evenly_spread(n[..., lit], TRIAL_PIXELS, -1) for n in (sample.levels, sample.swing, equalised.levels)
    )
    suspects = sorted(suspected(anomalies))
    before = total_inconsistency(plan, levels, swing)
    least, pair = total_inconsistency(plan, of_equalised, swing), (0, 0)
    tried: dict[tuple[int, int], float] = {}
    for swap, differ, remaining in _swaps(plan, levels, swing, suspects):
        tried[swap] = remaining
        if before - remaining > HALF * differ and remaining < least:
            least, pair = remaining, swap
    similar = [remaining for swap, remaining in tried.items() if len({*swap, *pair}) == 3]  # one frame in common
    if pair not in tried or tried[pair] > max(LEFT_BY_SWAP * before, AS_GOOD * min(similar, default=before)):
        return ""
    return f"with {plan.names(pair)} exchanged they do"


def _duplicate(plan: SequencePlan, sample: LitSample, anomalies: Sequence[Finding]) -> str:
    """Return a message that names a suspected frame and its duplicate, or ''."""
    for frame in sorted(suspected(anomalies)):
        equal = np.abs(sample.levels - sample.levels[frame]) < OUTLYING_SIGMAS * np.sqrt(2) * sample.sigma
        share = np.mean(equal, axis=1)
        for twin in np.flatnonzero(share > NEARLY_ALL).tolist():
            if not plan.shows_the_same(frame, twin):
                return f"{plan.names((frame, twin))} show the same"
    return ""


def _seen(sample: LitSample, sigmas: float = _SEEN) -> Bools:
    """Return the pixels (P,) of a sample that change with the patterns."""
    changing: Bools = (sample.swing > sigmas * np.sqrt(2) * sample.sigma) & (sample.swing > _LEAST_SWING)
    return changing


def _lit(levels: Floats32, noise: NoiseModel, saturation: float) -> NDArray[np.intp]:
    """Return some pixels of `levels` (frames, P) that the patterns light. Raises InputError if there are too few."""
    sample = LitSample.of(levels, noise)
    changing = _seen(sample)
    if np.count_nonzero(changing) < _FEWEST_LIT:
        raise FramesError(
            "no pixel changes clearly with the patterns: half of them vary by at most "
            f"{np.median(sample.swing):.1f} grey levels over the capture, where noise is {np.median(sample.sigma):.1f}",
            "is the projector on, the lens uncapped, the exposure long enough?",
        )
    lit = np.flatnonzero(changing & (levels.max(axis=0) < saturation))
    if len(lit) < _FEWEST_LIT:
        problem = "the frames are overexposed: all lit pixels reach the largest value"
        raise FramesError(problem, "shorten the exposure")
    well_lit = lit[_seen(sample, _WELL_SEEN)[lit]]
    return evenly_spread(well_lit if len(well_lit) >= FEWEST_PIXELS else lit)
