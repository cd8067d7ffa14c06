"""Ghosting: the share of the previous picture that a slow panel, or a camera that is early, leaves in every frame.

Frame k shows (1 − g) P(k) + g P(k − 1). As the previous picture is known, g P(k − 1) can be subtracted once g is known.
The right g makes the sums of pattern pairs, and of fringe steps, equal again.

A single late frame was exposed while the projector still showed part of the previous picture; all others are right. The
frame then contradicts the others: its sum with its inverse differs, and a bit without an inverse has more than two
levels. Subtracting the right share removes the contradiction. Steps of fringes are equalised in brightness anyway,
which leaves little of it.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.numerics import TRIAL_PIXELS, Floats32, Image, evenly_spread
from scanner.decoding.corrections.gains import TAILS
from scanner.decoding.light import ConstraintSet, PartOfFrames, residual_of_gains, saturation_level
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS, HALF, MAJORITY

# Range of shares: above it the frame is the previous picture, below it is harmless.
_LEAST_LATE, _MOST_LATE = 0.1, 0.75
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
# Range of detectable shares; less is harmless. From a half on, either picture may be the ghost.
_LEAST, _MOST = 0.02, 0.45
# Largest remaining share of the unevenness after correction: a ghost leaves a sixth, other causes a half, or a share at
# the limit.
_LEFT = 0.4
# Least difference between the shares of even and odd rows, if they differ.
_INTERLACED, _OF_THE_OTHER = 0.05, 0.3


@dataclass(frozen=True)
class Ghost:
    """The share of the previous picture that is left in frames."""

    share: float
    """Of the previous picture."""
    place: int | None = None
    """Of the only such frame in the capture; None if it is in each frame."""
    of_odd_rows: float | None = None
    """The share in odd rows, for a device that updates half of the rows at a time; None if the same."""

    def description(self, plan: SequencePlan) -> str:
        """Return a clause for the operator."""
        if self.of_odd_rows is not None:
            both = f"{self.share:.0%} and {self.of_odd_rows:.0%}"
            return f"each frame shows {both} of the picture before it in even and in odd rows"
        subject = "each frame shows" if self.place is None else f"{plan.name(plan.shown[self.place])} shows"
        return f"{subject} {self.share:.0%} of the picture before it"

    def of_rows(self, rows: NDArray[np.int64]) -> Floats32:
        """Return the share in rows of an image, by their numbers (...)."""
        odd = self.share if self.of_odd_rows is None else self.of_odd_rows
        return np.where(rows % 2, odd, self.share).astype(np.float32)

    def apply(self, frames: PartOfFrames, places: Sequence[int]) -> Iterator[Image]:
        """Yield the frames (...) at some places without the ghost; if it is in all frames alike, they stay darker by
        the factor 1 − g.

        Clipped pixels are unchanged. The picture before the first frame is taken as dark; if rows differ, as the first.
        """
        before: Floats32 | None = None
        is_even = self.place is None and self.of_odd_rows is None
        for place, frame in enumerate(frames.read(range(len(frames.plan.shown)))):
            if self.place is None or place in (self.place - 1, self.place):
                without = frame.astype(np.float32)
                if before is not None:
                    share = self.of_rows(frames.rows)
                    without -= share * before if not is_even else share / (1 - share) * before
                    # Restore the brightness of the other frames, or rows.
                    without *= np.float32(1) if is_even else 1 / (1 - share)
                before = without
                result = cast(Image, np.rint(np.clip(without, 0, np.iinfo(frame.dtype).max)).astype(frame.dtype))
                np.copyto(result, frame, where=frame >= saturation_level(frame))
                frame = result
            if place in places:
                yield frame


def find_ghost(plan: SequencePlan, levels: Floats32, rows: NDArray[np.int64]) -> Ghost | None:
    """Estimate the ghost in all frames, or else in one frame, from the levels (frames, P) of lit pixels that are not
    clipped, in image `rows` (P,).
    """
    if levels.shape[1] < FEWEST_PIXELS:
        return None
    share, _ = _share_and_unevenness(plan, levels)
    if share is not None:
        halves = [_share_and_unevenness(plan, levels[:, rows % 2 == side]) for side in (0, 1)]
        (even, off_even), (odd, off_odd) = ((of_half or 0.0, off) for of_half, off in halves)
        # The rows with the ghost are more uneven.
        if min(off_even, off_odd) < _OF_THE_OTHER * max(off_even, off_odd) and abs(even - odd) > _INTERLACED:
            return Ghost(even, of_odd_rows=odd)
    if share:
        return Ghost(share)
    late = late_frame(plan, evenly_spread(levels, TRIAL_PIXELS, axis=-1))
    return None if late is None else Ghost(*late)


def _share_and_unevenness(plan: SequencePlan, levels: Floats32) -> tuple[float | None, float]:
    """Estimate the previous picture's share in each frame of `levels` (frames, P), and the unevenness per pixel before
    correction.

    The share is 0 if it is not significant, None if a small share improves nothing.
    """
    sample = evenly_spread(levels, TRIAL_PIXELS, axis=-1)
    if not sample.size:
        return None, 0.0
    constraints = ConstraintSet(plan)

    def uneven(pictures: Floats32) -> float:
        # The worst sum is left out: a ghost affects all, a single brighter frame only one. Residuals of the steps from
        # a cosine are not used, because a nonlinear response leaves more.
        swing = np.ptp(pictures, axis=0)
        sums = [constraints.sums_off(pictures, groups) / swing for groups in constraints.kinds]
        off = np.concatenate([[0.0], *(np.mean(of_kind**2, axis=1) for of_kind in sums)])
        return float(off.sum() - off.max())

    at_first = uneven(sample)
    if uneven(without_previous(plan, sample, _LEAST)) >= at_first:
        return None, at_first
    share, remaining = share_of_previous(plan, sample, uneven, _MOST)
    # With only two sums, as of one fringe per axis, single frames of random exposure reach a quarter by chance.
    most = _LEFT if sum(map(len, constraints.kinds)) > 2 else HALF * _LEFT
    return (share if _LEAST < share < _MOST - _LEAST and remaining < most * at_first else 0.0), at_first


def late_frame(plan: SequencePlan, levels: Floats32) -> tuple[float, int] | None:
    """Return the share of the previous picture in the late frame, and its place in the capture; None if there is none.

    `levels` (frames, P): of some lit pixels in all frames.
    """
    relative = levels / np.ptp(levels, axis=0)
    best, least = None, 1.0
    for frames, off, most in _unusual(plan, relative):
        for frame in frames:
            place = plan.shown.index(frame)
            if place == 0 or float(np.std(relative[plan.shown[place - 1]])) < _LEAST_VARIETY:
                continue
            share, rest = share_of_previous(plan, relative, off, _MOST_LATE, (frame,))
            if plan.shown[place - 1] not in frames and rest > _OF_BRIGHTNESS * _off_once_equalised(relative, frames):
                continue
            if rest < least * most and _LEAST_LATE < share < _MOST_LATE - _LEAST_LATE:
                best, least = (share, place), rest / most
    return best


def _unusual(plan: SequencePlan, relative: Floats32) -> Iterator[tuple[tuple[int, ...], Off, float]]:
    """Yield pairs and single bits of unusual contradiction, with its measure and how much of it may remain, given
    levels (frames, P).
    """
    constraints, pairs = ConstraintSet(plan), plan.complements
    if len(pairs) >= MAJORITY:
        squares = np.mean((constraints.sums_off(relative, pairs) / 2) ** 2, axis=1)
        for number in np.flatnonzero(squares > max(_NOTABLE, _UNUSUAL_PAIR * float(np.median(squares)))).tolist():
            yield pairs[number], _off_common(constraints, number), _LEFT_OF_PAIRS * float(squares[number])
    in_pairs = {frame for pair in pairs for frame in pair}
    bits = sorted({frame for code in plan.codes for frame in code.frames} - in_pairs)
    if len(bits) >= MAJORITY and plan.white is not None and plan.black is not None:
        of_bits = {bit: _off_two_levels(plan.white, plan.black, bit) for bit in bits}
        scatter = {bit: off(relative) for bit, off in of_bits.items()}
        usual = float(np.median([*scatter.values()]))
        for bit, much in scatter.items():
            if much > max(_NOTABLE, _UNUSUAL_BIT * usual):
                yield (bit,), of_bits[bit], _LEFT_OF_BITS * much


def _off_common(constraints: ConstraintSet, number: int) -> Off:
    """Return the squared deviation of a pair's mean light from that of the others."""
    return lambda levels: float(np.mean((constraints.sums_off(levels, constraints.pairs)[number] / 2) ** 2))


def _off_once_equalised(relative: Floats32, frames: tuple[int, ...]) -> float:
    """Return what is left of the contradiction with optimal gains of the frames."""
    return (
        np.inf
        if len(frames) == 1
        else float(np.mean(residual_of_gains(relative[list(frames)], np.mean(relative, axis=0)) ** 2))
    )


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


def share_of_previous(
    plan: SequencePlan,
    levels: Floats32,
    off: Callable[[Floats32], float],
    most: float,
    frames: Collection[int] | None = None,
) -> tuple[float, float]:
    """Return the share up to `most` of the previous picture in some frames, or in all, without which `levels`
    (frames, P) contradict each other least, and what is `off` then.
    """

    def contradiction(share: float) -> float:
        return off(without_previous(plan, levels, share, frames))

    optimum = scipy.optimize.minimize_scalar(contradiction, bounds=(0, most), method="bounded", options={"xatol": 1e-3})
    return float(optimum.x), float(optimum.fun)


def without_previous(
    plan: SequencePlan, levels: Floats32, share: float, frames: Collection[int] | None = None
) -> Floats32:
    """Return the frames (frames, P) without a share of the previous picture in some of them, or in all; the picture
    before the first one is dark.
    """
    pictures: Floats32 = levels.copy()
    for frame in range(len(levels)) if frames is None else frames:
        place = plan.shown.index(frame)
        pictures[frame] /= np.float32(1 - share)
        if place:
            pictures[frame] -= np.float32(share / (1 - share)) * pictures[plan.shown[place - 1]]
    return pictures
