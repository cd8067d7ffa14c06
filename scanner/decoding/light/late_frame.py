"""Find a single frame that was exposed while the projector still showed part of the previous picture.

Frame k shows (1 − g) P(k) + g P(k − 1); all others are right. The frame then contradicts the others: its sum with its
inverse differs, and a bit without an inverse has more than two levels. Subtracting the right share removes the
contradiction. Steps of fringes are equalised in brightness anyway, which leaves little of it.
"""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.optimize import minimize_scalar

from scanner.decoding.arrays import Floats32
from scanner.decoding.light.bits_without_inverse import TAILS
from scanner.decoding.light.brightness import left_by_gains
from scanner.decoding.light.lit_pixels import thinned
from scanner.decoding.medians import medians
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS, MAJORITY
from scanner.decoding.subsampling import TRIAL_PIXELS

# Range of shares: above it the frame is the previous picture, below it is harmless.
_LEAST, _MOST = 0.1, 0.75
# Largest remaining share of the contradiction. Late frames with inverses leave a few hundredths, brightness changes a
# third and more; single bits, whose levels interreflection spreads, up to three tenths.
_LEFT = {"pairs": 0.15, "bits": 0.35}
# Contradiction that a share of a tenth causes, in squared swings; and least ratio to the usual contradiction.
_NOTABLE, _UNUSUAL = 0.002, {"pairs": 10.0, "bits": 2.5}
# Largest share of what equal brightness would leave. A preceding inverse of the same bit looks like a brightness
# change.
_OF_BRIGHTNESS = 0.3
_LEAST_VARIETY = 0.2  # of the previous picture, in swings: a black one only darkens the frame

Off = Callable[[Floats32], float]


def late_frame(plan: SequencePlan, levels: Floats32) -> tuple[float, int] | None:
    """Return the share of the previous picture in the late frame, and its place in the capture; None if there is none.

    `levels` (frames, P): of lit pixels in all frames.
    """
    seen = thinned(levels, TRIAL_PIXELS)
    seen = seen / np.ptp(seen, axis=0)
    best, least = None, 1.0
    for kind, frames, off in _groups(plan, seen):
        at_first = off(seen)
        if at_first < _NOTABLE:
            continue
        for frame in frames:
            place = plan.shown.index(frame)
            if place == 0:
                continue
            before = seen[plan.shown[place - 1]]
            if float(np.std(before)) < _LEAST_VARIETY:
                continue

            def left(share: float, frame: int = frame, before: Floats32 = before, off: Off = off) -> float:
                levels = seen.copy()
                levels[frame] = (levels[frame] - share * before) / (1 - share)
                return off(levels)

            found = minimize_scalar(left, bounds=(0, _MOST), method="bounded", options={"xatol": 1e-3})
            rest = float(found.fun) / at_first / _LEFT[kind]
            if plan.shown[place - 1] not in frames and float(found.fun) > _OF_BRIGHTNESS * _off_once_alike(
                seen, frames
            ):
                continue
            if rest < least and _LEAST < found.x < _MOST - _LEAST:
                best, least = (float(found.x), place), rest
    return best


def _groups(plan: SequencePlan, seen: Floats32) -> Iterator[tuple[str, tuple[int, ...], Off]]:
    """Yield pairs and single bits of unusual contradiction, with its measure, given levels (frames, P)."""
    pairs = plan.complements
    if len(pairs) >= MAJORITY:
        common = medians(np.stack([np.mean(seen[list(pair)], axis=0) for pair in pairs]), axis=0)
        yield from _unusual("pairs", [(pair, _off_common(pair, common)) for pair in pairs], seen)
    if plan.white is not None and plan.black is not None:
        in_pairs = {frame for pair in plan.complements for frame in pair}
        bits = {frame for axis in plan.axes for code in axis.codes for frame in code.frames} - in_pairs
        yield from _unusual(
            "bits", [((bit,), _off_two_levels(plan.white, plan.black, bit)) for bit in sorted(bits)], seen
        )


def _unusual(
    kind: str, groups: list[tuple[tuple[int, ...], Off]], seen: Floats32
) -> Iterator[tuple[str, tuple[int, ...], Off]]:
    if len(groups) >= MAJORITY:
        usual = float(np.median([off(seen) for _, off in groups]))
        yield from ((kind, frames, off) for frames, off in groups if off(seen) > _UNUSUAL[kind] * usual)


def _off_common(frames: tuple[int, ...], common: Floats32) -> Off:
    return lambda levels: float(np.mean((np.mean(levels[list(frames)], axis=0) - common) ** 2))


def _off_once_alike(seen: Floats32, frames: tuple[int, ...]) -> float:
    """Return what is left of the contradiction with optimal gains of the frames."""
    return np.inf if len(frames) == 1 else float(np.mean(left_by_gains(seen[list(frames)], np.mean(seen, axis=0)) ** 2))


def _off_two_levels(white: int, black: int, bit: int) -> Off:
    def off(levels: Floats32) -> float:
        between = levels[white] - levels[black]
        lit = between > np.float32(0.5)
        relative = (levels[bit] - levels[black])[lit] / between[lit]
        if len(relative) < FEWEST_PIXELS:
            return 0.0
        is_bright = relative > np.mean(np.quantile(relative, TAILS))
        groups = [relative[is_bright], relative[~is_bright]]
        squares = sum(float(np.sum((group - np.median(group)) ** 2)) for group in groups if len(group))
        return squares / len(relative)

    return off
