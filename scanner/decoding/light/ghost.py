"""Ghosting: the share of the previous picture that a slow panel, or a camera that is early, leaves in every frame.

Frame k shows (1 − g) P(k) + g P(k − 1). As the previous picture is known, g P(k − 1) can be subtracted once g is known.
The right g makes the sums of pattern pairs, and of fringe steps, equal again.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from calib.numerics import TRIAL_PIXELS, Floats32, Image, evenly_spread
from scanner.decoding.light.late_frame import late_frame
from scanner.decoding.light.previous_picture import share_of_previous, sums_off, without_previous
from scanner.decoding.light.saturation_level import saturation_level
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS, HALF

# Range of detectable shares; less is harmless. From a half on, either picture may be the ghost.
_LEAST, _MOST = 0.02, 0.45
# Largest remaining share of the unevenness after correction: a ghost leaves a sixth, other causes a half, or a share at
# the limit.
_LEFT = 0.4
# Least difference between the shares of even and odd rows, if they differ.
_INTERLACED, _OF_THE_OTHER = 0.05, 0.3


@dataclass(frozen=True)
class Ghost:
    """The `share` of the previous picture in the frame at a `place` of the capture, or in each frame if None.

    `of_odd_rows`: the share in odd rows, for a device that updates half of the rows at a time; None if the same.
    """

    share: float
    place: int | None = None
    of_odd_rows: float | None = None

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


def without_ghost(frames: Iterable[Image], ghost: Ghost, rows: NDArray[np.int64]) -> Iterator[Image]:
    """Yield the frames (N, ...) of a capture without the ghost; if it is in all frames alike, they stay darker by the
    factor 1 − g.

    `rows` (...): numbers of the image rows.

    Clipped pixels are unchanged. The picture before the first frame is taken as dark; if rows differ, as the first one.
    """
    before: Floats32 | None = None
    is_even = ghost.place is None and ghost.of_odd_rows is None
    for place, frame in enumerate(frames):
        if ghost.place is not None and place not in (ghost.place - 1, ghost.place):
            yield frame
            continue
        without = frame.astype(np.float32)
        if before is not None:
            share = ghost.of_rows(rows)
            without -= share * before if not is_even else share / (1 - share) * before
            # Restore the brightness of the other frames, or rows.
            without *= np.float32(1) if is_even else 1 / (1 - share)
        before = without
        result = cast(Image, np.rint(np.clip(without, 0, np.iinfo(frame.dtype).max)).astype(frame.dtype))
        np.copyto(result, frame, where=frame >= saturation_level(frame))
        yield result


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
    seen = evenly_spread(levels, TRIAL_PIXELS, axis=-1)
    if not seen.size:
        return None, 0.0
    kinds = plan.complements, [fringe.frames for fringe in plan.fringes if fringe.equal_steps]
    sums = [groups for groups in kinds if len(groups) > 1]

    def uneven(pictures: Floats32) -> float:
        # The worst sum is left out: a ghost affects all, a single brighter frame only one. Residuals of the steps from
        # a cosine are not used, because a nonlinear response leaves more.
        swing = np.ptp(pictures, axis=0)
        off = np.concatenate([[0.0], *(np.mean((sums_off(pictures, each) / swing) ** 2, axis=1) for each in sums)])
        return float(off.sum() - off.max())

    at_first = uneven(seen)
    if uneven(without_previous(plan, seen, _LEAST)) >= at_first:
        return None, at_first
    share, left = share_of_previous(plan, seen, uneven, _MOST)
    # With only two sums, as of one fringe per axis, single frames of random exposure reach a quarter by chance.
    most = _LEFT if sum(map(len, sums)) > 2 else HALF * _LEFT
    return (share if _LEAST < share < _MOST - _LEAST and left < most * at_first else 0.0), at_first
