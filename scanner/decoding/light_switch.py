"""Light that is switched on or off during the capture: from some frame on, every pixel has more of it, or less.

Unlike a lamp that flickers it adds to the frames, by an amount of its own at each pixel. It shows in the sums of pairs
and fringes: from one on they are all off, by light of one sign.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.sequence_plan import SequencePlan

# Of the squares of the added light, those of the other sign; noise is of both.
_MOST_OF_OTHER_SIGN = 0.1
# Switched at the right frame, it explains most contradictions; within one group of frames, any moment looks alike.
_MOST_LEFT, _AS_GOOD = 0.5, 0.8


@dataclass(frozen=True)
class LightSwitch:
    """From `frame` on there is as much more `light` (P,) at some pixels; in grey levels."""

    frame: int
    light: Floats32

    def undone(self, levels: Floats32) -> Floats32:
        """The frames (frames, P) as they would be in the first light."""
        result = levels.copy()
        result[self.frame :] -= self.light
        return result


def light_switch(
    plan: SequencePlan, levels: Floats32, swing: Floats32, contradiction: Callable[[Floats32], float]
) -> LightSwitch | None:
    """The one that explains most of what is contradictory about the `levels` (frames, P); None if none does.

    `swing` (P,): how far the levels of a pixel are apart. `contradiction` measures frames (frames, P).
    """
    kinds: list[Sequence[Sequence[int]]] = [
        plan.complements,
        [fringe.frames for fringe in plan.fringes if fringe.equal_steps],
    ]
    groups = [[list(frames) for frames in kind] for kind in kinds if len(kind) > 1]
    if not groups:
        return None
    means = np.concatenate([_centred(np.stack([levels[frames].mean(axis=0) for frames in kind])) for kind in groups])
    moments = np.arange(1, len(levels))
    # (groups, moments): the share of the frames of each that comes after.
    after = np.concatenate(
        [
            _centred(np.stack([np.mean(np.array(frames)[:, None] >= moments, axis=0) for frames in kind]))
            for kind in groups
        ]
    )
    squares = np.sum(after**2, axis=0)
    along = after.T @ means
    explained = np.mean((along / swing) ** 2, axis=1) / np.maximum(squares, 1e-9)
    candidates = [
        LightSwitch(int(moments[at]), (along[at] / squares[at]).astype(np.float32))
        for at in np.flatnonzero((explained >= _AS_GOOD * explained.max()) & (squares > 1e-9))
    ]
    candidates = [candidate for candidate in candidates if _is_of_one_sign(candidate.light / swing)]
    left = [contradiction(candidate.undone(levels)) for candidate in candidates]
    if not left or min(left) > _MOST_LEFT * contradiction(levels):
        return None
    return candidates[int(np.argmin(left))]


def _centred(values: Floats) -> Floats:
    centred: Floats = values - values.mean(axis=0)
    return centred


def _is_of_one_sign(light: Floats32) -> bool:
    brighter, darker = (float(np.sum(np.maximum(sign * light, 0) ** 2)) for sign in (1, -1))
    return min(brighter, darker) <= _MOST_OF_OTHER_SIGN * max(brighter, darker)
