"""A ghost: the share of the picture before that a slow panel, or a camera that is early, leaves in every frame.

Frame k shows (1 − g) P(k) + g P(k − 1). The picture before is known, and so g P(k − 1) can be taken out, if g is known:
with the right share the light of patterns and inverses, and of the steps of fringes, adds up again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import minimize_scalar

from calib.numerics import Image
from scanner.decoding.arrays import Floats32
from scanner.decoding.light.brightness import lit_by
from scanner.decoding.light.late_frame import late_frame
from scanner.decoding.light.saturation_level import saturation_level
from scanner.decoding.medians import medians
from scanner.decoding.sequence_plan import SequencePlan

# The shares that are looked for; less does no harm. With a half and more either picture may be the ghost.
_LEAST, _MOST = 0.02, 0.45
# What taking it out may leave of the unevenness: of a ghost a sixth is left, of other causes a half, or they want most.
_LEFT = 0.4
_TRIED = 0.03
_FEWEST_PIXELS = 100
_MOST_PIXELS = 400


@dataclass(frozen=True)
class Ghost:
    """The `share` of the picture before that the frame in a `place` of the capture shows; None: each frame does."""

    share: float
    place: int | None = None

    def said(self, plan: SequencePlan) -> str:
        """For the operator."""
        who = "each frame shows" if self.place is None else f"{plan.name(plan.shown[self.place])} shows"
        return f"{who} {self.share:.0%} of the picture before it"


class GhostRemover:
    """Takes a ghost out of frames that come one after the other; before the first it was dark."""

    def __init__(self, ghost: Ghost) -> None:
        self._ghost, self._place = ghost, 0
        self._before: Floats32 | None = None

    def remove(self, image: Image) -> Image:
        """The next frame (H, W) without it, if each has one as much darker; a clipped pixel stays as it is."""
        place, self._place = self._place, self._place + 1
        if self._ghost.place is not None and place not in (self._ghost.place - 1, self._ghost.place):
            return image
        clipped = image >= saturation_level(image)
        without = image.astype(np.float32)
        share = self._ghost.share
        if self._before is not None and self._ghost.place is None:
            without -= np.float32(share / (1 - share)) * self._before
        elif self._before is not None:  # as bright as the other frames
            without = (without - np.float32(share) * self._before) * np.float32(1 / (1 - share))
        self._before = without
        highest = np.iinfo(image.dtype).max
        result = cast(Image, np.rint(np.clip(without, 0, highest)).astype(image.dtype))
        np.copyto(result, image, where=clipped)
        return result


def find_ghost(plan: SequencePlan, levels: Floats32, saturation: float) -> Ghost | None:
    """That of all frames which a sample `levels` (frames, P) tells of, or else of one."""
    if share := ghost_share(plan, levels, saturation):
        return Ghost(share)
    late = late_frame(plan, levels, saturation)
    return None if late is None else Ghost(late.share, late.place)


def ghost_share(plan: SequencePlan, levels: Floats32, saturation: float) -> float:
    """How much of the picture before each frame of a sample `levels` (frames, P) shows; 0 if none can be told."""
    lit = lit_by(np.ptp(levels, axis=0))
    lit = lit[levels[:, lit].max(axis=0) < saturation]
    if len(lit) < _FEWEST_PIXELS:
        return 0.0
    seen = levels[:, lit[:: -(-len(lit) // _MOST_PIXELS)]]
    before = [plan.shown[max(0, plan.shown.index(frame) - 1)] for frame in range(len(seen))]

    def left(share: float) -> float:
        return _uneven(plan, _without(seen, before, share))

    at_first = left(0.0)
    if left(_TRIED) >= at_first:
        return 0.0
    found = minimize_scalar(left, bounds=(0, _MOST), method="bounded", options={"xatol": 1e-3})
    share = float(found.x)
    return share if _LEAST < share < _MOST - _LEAST and found.fun < _LEFT * at_first else 0.0


def _without(levels: Floats32, before: list[int], share: float) -> Floats32:
    ratio = np.float32(share / (1 - share))
    pictures: Floats32 = levels.copy()
    for frame in range(1, len(pictures)):
        pictures[frame] -= ratio * pictures[before[frame]]
    return pictures


def _uneven(plan: SequencePlan, pictures: Floats32) -> float:
    """How far the light of pairs, and that of fringes in even steps, differs from one to the next, squared; in swings
    of the pixels. The one that is furthest off does not count, for a ghost is in all of them, a brighter frame in one.
    What steps leave of a cosine is no measure: a bent brightness curve leaves more.
    """
    fringes = [fringe.frames for fringe in plan.fringes if fringe.equal_steps]
    kinds: tuple[Sequence[Sequence[int]], ...] = plan.complements, fringes
    off = [0.0]
    for groups in kinds:
        if len(groups) > 1:
            light = np.stack([np.sum(pictures[list(frames)], axis=0) for frames in groups])
            off += np.sum(((light - medians(light, axis=0)) / np.ptp(pictures, axis=0)) ** 2, axis=1).tolist()
    return sum(off) - max(off)
