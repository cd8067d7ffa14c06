"""Check that each frame shows the pattern that the capture states, on a sample of all frames before decoding.

Light adds up: white is the brightest of all frames and black the darkest, pattern and inverse add up to white plus
black, and the mean of a fringe over its shifts is the same grey everywhere. This holds under any interreflection and
any brightness curve of the projector. Exchanged, duplicated or foreign frames break it; so do passing people and some
devices. An exchange is proven by exchanging the frames back, a duplicate by the identical frame. Everything else is an
anomaly that is assessed later by the coordinates.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import TRIAL_PIXELS, Bools, Floats32, evenly_spread, median, medians, robust_sigmas
from scanner.decoding.light.ambient_light_change import AmbientLightChange, light_switch, may_be_switched
from scanner.decoding.light.constraints import ConstraintSet, LitSample, NoiseModel
from scanner.decoding.light.exposures import LIT
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import (
    AS_GOOD,
    BRIGHTEST,
    FEWEST_PIXELS,
    HALF,
    HUBER_SIGMAS,
    NEARLY_ALL,
    OUTLYING_SIGMAS,
)
from scanner.errors import FramesError, InputError

# Largest share of the lit pixels at which frames may be off by half of what an exchange causes: people and occlusion
# edges cover less, an exchanged frame is wrong where its pattern differs.
_WRONG_SHARE = 0.05
# Largest share that occlusion edges, undersampled stripes and people break of the coordinates that depend on a frame.
# If it shows another pattern, half of them are wrong.
MOST_BROKEN = 0.35
# Exchanged frames are named, and a fringe is none, if a right sequence leaves more than this share of the
# contradictions: all but those of noise and of the projector's and the camera's curves, which leave 0.05.
LEFT_BY_SWAP = 0.3
# Least swing of a lit pixel over all frames: in standard deviations of a difference of two, of which a hundred frames
# have thousands, and in grey levels, which rounding alone may differ by. Better pixels are preferred.
_SEEN, _WELL_SEEN, _LEAST_SWING = 8.0, 20.0, 2.0
_FEWEST_LIT = 20  # of the sample: in the fewest pixels that can be decoded at all, 0.1 % of the picture
# Each misplaced frame adds the square of its difference from the right one to the contradictions, twice that if only
# one other frame contradicts it. Undoing an exchange must remove at least this part.
# It is rejected if another exchange of either frame leaves hardly more: if black was taken in brighter light, for
# example, any dark frame in its place helps as much.
_DIFFERENT = 0.02  # least mean squared difference of exchanged frames, in swings: less does no harm
# Flicker and automatic exposure change white, and black, by less than this factor.
_MOST_BRIGHTER = 4.0

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


def check_frames(
    plan: SequencePlan, levels: Floats32, equalised: Floats32, noise: NoiseModel, saturation: float
) -> tuple[list[Finding], AmbientLightChange | None]:
    """Return the anomalies of the sample `levels` (frames, P), and an ambient light change if there was one.

    `equalised`: the levels after equalising brightness, which resolves some contradictions.

    Raises InputError if nothing is lit, or if frames were certainly exchanged or duplicated.
    """
    lit = _lit(LitSample.of(ConstraintSet(plan), levels, noise), saturation)
    sample = LitSample.of(ConstraintSet(plan), levels[:, lit], noise)
    anomalies = find_anomalies(sample)
    if not anomalies and not may_be_switched(plan, sample.levels):
        return [], None
    explained, switch = _in_one_light(sample, sample.by(equalised[:, lit]))
    explained = _with_brighter_white(explained)
    if not anomalies and switch is None:
        return [], None
    switched = [] if switch is None else [anomaly(switch.description(plan), [switch.frame])]
    mistake = _find_swap(sample, explained, anomalies) or _duplicate(sample, anomalies)
    if mistake:
        first, *further = [*(finding.message for finding in anomalies), mistake]
        problem = f"the frames do not show what the capture says: {first}"
        raise FramesError(problem, "; ".join(further)) if further else InputError(problem)
    return [*switched, *find_anomalies(explained)], switch


def agree(plan: SequencePlan, levels: Floats32, noise: NoiseModel, saturation: float) -> bool:
    """Return whether enough pixels of the sample (frames, P) are lit, and nothing in them contradicts the sequence."""
    sample = LitSample.of(ConstraintSet(plan), levels, noise)
    lit = np.flatnonzero(_seen(sample) & (levels.max(axis=0) < saturation))
    return len(lit) >= FEWEST_PIXELS and not find_anomalies(sample.at(lit))


def is_explained_by_swap(plan: SequencePlan, levels: Floats32, suspects: Sequence[int]) -> bool:
    """Return whether exchanging two frames, one a suspect, removes most contradictions in the sample (frames, P)."""
    swing = np.ptp(levels, axis=0)
    lit = evenly_spread(np.flatnonzero(swing > _LEAST_SWING), TRIAL_PIXELS)
    if not len(lit):
        return False
    sample = LitSample(ConstraintSet(plan), levels[:, lit], swing[lit], np.zeros_like(swing[lit]))
    most = LEFT_BY_SWAP * sample.inconsistency
    return any(remaining < most for _, _, remaining in _swaps(sample, suspects))


def _swaps(sample: LitSample, suspects: Sequence[int]) -> Iterator[tuple[tuple[int, int], float, float]]:
    """Yield pairs of frames that differ, one a suspect, with their mean squared difference in swings, and the
    inconsistency once they are exchanged.
    """
    levels = sample.levels
    for first in suspects:
        for second in range(len(levels)):
            differ = float(np.mean(((levels[first] - levels[second]) / sample.swing) ** 2))
            if differ >= _DIFFERENT and not (second in suspects and second < first):
                order = np.arange(len(levels))
                order[[first, second]] = second, first
                yield (first, second), differ, sample.by(levels[order]).inconsistency


def _in_one_light(sample: LitSample, equalised: LitSample) -> tuple[LitSample, AmbientLightChange | None]:
    """Remove an ambient light change, from the equalised frames or the original ones, whichever is more consistent.

    There was none if the equalised frames are consistent, as a darker step of a fringe looks like light at the opposite
    one. Nor if lamps flicker, and the two gains of white and black, which nothing else tells, explain the frames about
    as well as a light of its own at each pixel.
    """
    best: tuple[LitSample, AmbientLightChange | None] = equalised, None
    if _is_consistent(equalised):
        return best
    for frames in (equalised, sample):
        switch = None if _is_consistent(frames) else light_switch(frames)
        if switch is not None:
            without = frames.by(switch.undone(frames.levels))
            best = min(best, (without, switch), key=lambda choice: choice[0].inconsistency)
    flickers = not np.array_equal(equalised.levels, sample.levels)
    if best[1] is None or not flickers:
        return best
    flickered = equalised
    for frame in (*_ends(sample), *_ends(sample)):
        flickered = _with_gain(flickered, frame, 1 / _MOST_BRIGHTER)
    return (equalised, None) if AS_GOOD * flickered.inconsistency <= best[0].inconsistency else best


def _ends(sample: LitSample) -> list[int]:
    return [frame for frame in (sample.constraints.plan.white, sample.constraints.plan.black) if frame is not None]


def _is_consistent(sample: LitSample) -> bool:
    return not find_anomalies(sample) and not may_be_switched(sample.constraints.plan, sample.levels)


def _with_brighter_white(equalised: LitSample) -> LitSample:
    """Return the frames with white brightened to be most consistent, if that helps much.

    The exposure of white is unknown, except that white is brightest: devices with automatic exposure record it too
    dark.
    """
    if equalised.constraints.plan.white is None:
        return equalised
    brighter = _with_gain(equalised, equalised.constraints.plan.white, 1)
    return brighter if brighter.inconsistency < HALF * equalised.inconsistency else equalised


def _with_gain(equalised: LitSample, frame: int, least: float) -> LitSample:
    """Return the frames, of which one is scaled by `least` or more to be most consistent."""

    def by(factor: float) -> LitSample:
        levels = equalised.levels.copy()
        levels[frame] *= np.float32(factor)
        return equalised.by(levels)

    optimum = scipy.optimize.minimize_scalar(
        lambda factor: by(factor).inconsistency,
        bounds=(least, _MOST_BRIGHTER),
        method="bounded",
        options={"xatol": 0.01},
    )
    return by(float(optimum.x))


def _find_swap(sample: LitSample, explained: LitSample, anomalies: Sequence[Finding]) -> str:
    """Return a message that names two exchanged frames, or ''.

    Exchanging them back must reduce the contradictions in proportion to their difference. They are not named if
    brightness and light that are `explained` leave as little, or if another exchange of one of them does nearly as
    well.
    """
    # Beside the picture frames differ by their exposures alone, which any dark frame in the place of black explains.
    lit = evenly_spread(np.flatnonzero(sample.swing >= LIT * np.quantile(sample.swing, BRIGHTEST)), TRIAL_PIXELS)
    before = sample.at(lit).inconsistency
    least, pair = explained.at(lit).inconsistency, (0, 0)
    tried: dict[tuple[int, int], float] = {}
    for swap, differ, remaining in _swaps(sample.at(lit), sorted(suspected(anomalies))):
        tried[swap] = remaining
        if before - remaining > HALF * differ and remaining < least:
            least, pair = remaining, swap
    similar = [remaining for swap, remaining in tried.items() if len({*swap, *pair}) == 3]  # one frame in common
    if pair not in tried or tried[pair] > max(LEFT_BY_SWAP * before, AS_GOOD * min(similar, default=before)):
        return ""
    return f"with {sample.constraints.plan.names(pair)} exchanged they do"


def _duplicate(sample: LitSample, anomalies: Sequence[Finding]) -> str:
    """Return a message that names a suspected frame and its duplicate, or ''."""
    plan = sample.constraints.plan
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


def _lit(sample: LitSample, saturation: float) -> NDArray[np.intp]:
    """Return some pixels of a sample that the patterns light. Raises InputError if there are too few."""
    changing = _seen(sample)
    if np.count_nonzero(changing) < _FEWEST_LIT:
        raise FramesError(
            "no pixel changes clearly with the patterns: half of them vary by at most "
            f"{np.median(sample.swing):.1f} grey levels over the capture, where noise is {np.median(sample.sigma):.1f}",
            "is the projector on, the lens uncapped, the exposure long enough?",
        )
    lit = np.flatnonzero(changing & (sample.levels.max(axis=0) < saturation))
    if len(lit) < _FEWEST_LIT:
        problem = "the frames are overexposed: all lit pixels reach the largest value"
        raise FramesError(problem, "shorten the exposure")
    well_lit = lit[_seen(sample, _WELL_SEEN)[lit]]
    return evenly_spread(well_lit if len(well_lit) >= FEWEST_PIXELS else lit)


def find_anomalies(sample: LitSample) -> list[Finding]:
    """Return all contradictions between the frames and the sequence."""
    return [*_extremes(sample), *_pairs(sample), *_fringes(sample)]


def _extremes(sample: LitSample) -> Iterator[Finding]:
    plan = sample.constraints.plan
    for frame, excess in sample.constraints.beyond_ends(sample.levels):
        beyond = excess > HALF * sample.swing
        wrong = np.mean(beyond.any(axis=0))
        if wrong > _WRONG_SHARE:
            suspect = int(np.argmax(np.count_nonzero(beyond, axis=1)))
            yield anomaly(
                f"{plan.name(frame)} is {'darker' if frame == plan.white else 'brighter'} than others at {wrong:.0%} "
                f"of the lit pixels, above all than {plan.name(suspect)}",
                (frame, suspect),
            )


def _pairs(sample: LitSample) -> Iterator[Finding]:
    plan, pairs = sample.constraints.plan, sample.constraints.pairs
    if len(pairs) < 2:
        return
    wrong = np.mean(np.abs(sample.constraints.sums_off(sample.levels, pairs)) > HALF * sample.swing, axis=1)
    suspects = [frame for pair, share in zip(pairs, wrong, strict=True) for frame in pair if share > _WRONG_SHARE]
    if suspects:
        yield anomaly(
            f"pattern and inverse do not complement each other at {wrong.max():.0%} of the lit pixels, in "
            f"{plan.names(suspects)}",
            suspects,
        )


def _fringes(sample: LitSample) -> Iterator[Finding]:
    """Yield the fringes whose mean is uneven, or whose steps make no cosine; blurred ones cannot be checked."""
    plan = sample.constraints.plan
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
        if np.mean(sample.constraints.off_cosine(fringe, sample.levels) ** 2) > LEFT_BY_SWAP * np.mean(swings**2):
            yield anomaly(f"{plan.names(fringe.frames)} make no fringe together", fringe.frames)
