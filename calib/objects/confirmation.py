"""Which pixels of each view other views confirm, once poses are known: the rest is background, or an error."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.numerics import Bools
from calib.objects.joint import NARROW
from calib.objects.patch_overlap import overlapping_pixels
from calib.objects.view import ObjectView, without_small_pieces
from calib.registration import THROUGH_FREE_SPACE, Patches

_FEWEST = 4  # number of views from which a point must be seen by another view as well


@dataclass(frozen=True, eq=False)
class Confirmation:
    """Of one view: `of_thing` (H, W), the pixels confirmed by others; `apart` (H, W), their mean distance in front of
    the others' surfaces, in the points' unit, NaN where unknown.
    """

    of_thing: Bools
    apart: NDArray[np.float32]


def confirmed(views: Sequence[ObjectView], places: Sequence[Pose]) -> list[Confirmation]:
    """For each view; `places`: X_common = R X_view + t."""
    found = []
    for k, (view, place) in enumerate(zip(views, places, strict=True)):
        there = np.isfinite(view.image.points[..., 2])
        patches = Patches(*(values[there].astype(np.float64) for values in view.image[:2]))
        seen, through = np.zeros((2, len(patches.points)), np.int64)
        total = np.zeros(len(patches.points))
        for other, (seen_by, at) in enumerate(zip(views, places, strict=True)):
            if other != k:
                to_other = at.inverse() @ place
                overlap = overlapping_pixels(patches, seen_by, to_other, NARROW * view.grain)
                met = np.flatnonzero(overlap >= 0)
                moved = to_other @ patches.points[met]
                theirs, towards = (values.reshape(-1, 3)[overlap[met]] for values in seen_by.image[:2])
                total[met] += np.sum(towards * (moved - theirs), axis=1)
                seen[met] += 1
                through += overlap == THROUGH_FREE_SPACE
        kept = there.copy()
        kept[there] = (seen >= through) & (seen >= (1 if len(views) >= _FEWEST else 0))
        of_thing = without_small_pieces(kept)
        apart = np.full(there.shape, np.nan, np.float32)
        with np.errstate(invalid="ignore"):
            apart[there] = total / seen
        found.append(Confirmation(of_thing, np.where(of_thing, apart, np.float32(np.nan))))
    return found
