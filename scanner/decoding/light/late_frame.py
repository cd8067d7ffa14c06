"""Find a single frame that was exposed while the projector still showed part of the previous picture.

Frame k shows (1 − g) P(k) + g P(k − 1); all others are right. The frame then contradicts the others: its sum with its
inverse differs, and a bit without an inverse has more than two levels. Subtracting the right share removes the
contradiction. Steps of fringes are equalised in brightness anyway, which leaves little of it.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from calib.numerics import Floats32
from scanner.decoding.light.bits_without_inverse import TAILS
from scanner.decoding.light.brightness import left_by_gains
from scanner.decoding.light.previous_picture import share_of_previous, sums_off
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS, MAJORITY

# Range of shares: above it the frame is the previous picture, below it is harmless.
_LEAST, _MOST = 0.1, 0.75
# Largest remaining share of the contradiction of pairs and of bits. Late frames with inverses leave a few hundredths,
# brightness changes a third and more; single bits, whose levels interreflection spreads, up to three tenths.
_LEFT_OF_PAIRS, _LEFT_OF_BITS = 0.15, 0.35
# Contradiction that a share of a tenth causes, in squared swings; and least ratio to that of the usual pair and bit.
_NOTABLE, _UNUSUAL_PAIR, _UNUSUAL_BIT = 0.002, 10.0, 2.5
# Largest share of what equal brightness would leave. A preceding inverse of the same bit looks like a brightness
# change.
_OF_BRIGHTNESS = 0.3
_LEAST_VARIETY = 0.2  # of the previous picture, in swings: a black one only darkens the frame

Off = Callable[[Floats32], float]


def late_frame(plan: SequencePlan, levels: Floats32) -> tuple[float, int] | None:
    """Return the share of the previous picture in the late frame, and its place in the capture; None if there is none.

    `levels` (frames, P): of some lit pixels in all frames.
    """
    seen = levels / np.ptp(levels, axis=0)
    best, least = None, 1.0
    for frames, off, most in _unusual(plan, seen):
        for frame in frames:
            place = plan.shown.index(frame)
            if place == 0 or float(np.std(seen[plan.shown[place - 1]])) < _LEAST_VARIETY:
                continue
            share, rest = share_of_previous(plan, seen, off, _MOST, (frame,))
            if plan.shown[place - 1] not in frames and rest > _OF_BRIGHTNESS * _off_once_alike(seen, frames):
                continue
            if rest < least * most and _LEAST < share < _MOST - _LEAST:
                best, least = (share, place), rest / most
    return best


def _unusual(plan: SequencePlan, seen: Floats32) -> Iterator[tuple[tuple[int, ...], Off, float]]:
    """Yield pairs and single bits of unusual contradiction, with its measure and how much of it may remain, given
    levels (frames, P).
    """
    pairs = plan.complements
    if len(pairs) >= MAJORITY:
        squares = np.mean((sums_off(seen, pairs) / 2) ** 2, axis=1)
        for number in np.flatnonzero(squares > max(_NOTABLE, _UNUSUAL_PAIR * float(np.median(squares)))).tolist():
            yield pairs[number], _off_common(pairs, number), _LEFT_OF_PAIRS * float(squares[number])
    in_pairs = {frame for pair in pairs for frame in pair}
    bits = sorted({frame for code in plan.codes for frame in code.frames} - in_pairs)
    if len(bits) >= MAJORITY and plan.white is not None and plan.black is not None:
        of_bits = {bit: _off_two_levels(plan.white, plan.black, bit) for bit in bits}
        found = {bit: off(seen) for bit, off in of_bits.items()}
        usual = float(np.median([*found.values()]))
        for bit, much in found.items():
            if much > max(_NOTABLE, _UNUSUAL_BIT * usual):
                yield (bit,), of_bits[bit], _LEFT_OF_BITS * much


def _off_common(pairs: Sequence[Sequence[int]], number: int) -> Off:
    """Return the squared deviation of a pair's mean light from that of the others."""
    return lambda levels: float(np.mean((sums_off(levels, pairs)[number] / 2) ** 2))


def _off_once_alike(seen: Floats32, frames: tuple[int, ...]) -> float:
    """Return what is left of the contradiction with optimal gains of the frames."""
    return np.inf if len(frames) == 1 else float(np.mean(left_by_gains(seen[list(frames)], np.mean(seen, axis=0)) ** 2))


def _off_two_levels(white: int, black: int, bit: int) -> Off:
    """Return the scatter of a bit's levels about two; 0 if it has few pixels."""

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
