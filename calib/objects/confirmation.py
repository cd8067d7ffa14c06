"""What of each view other views confirm, once their places are known: the rest rested, or was never there."""

from collections.abc import Sequence

import numpy as np

from calib.geometry import Motion
from calib.numerics import Bools
from calib.objects.joint import NARROW
from calib.objects.meeting import LOOKED_THROUGH, meet_points
from calib.objects.view import View, without_crumbs
from calib.rooms.alignment import composed, inverse

_FEWEST = 4  # views, from which on a point has to be seen by another one, too


def confirmed(views: Sequence[View], places: Sequence[Motion]) -> list[Bools]:
    """For each view which of its pixels (H, W) are of the thing: seen by others where they should be.

    `places`: X_common = R X_view + t.
    """
    found = []
    for k, (view, place) in enumerate(zip(views, places, strict=True)):
        there = np.isfinite(view.points[..., 2])
        points, normals = (each[there].astype(np.float64) for each in (view.points, view.normals))
        seen, through = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
        for other, (seen_by, at) in enumerate(zip(views, places, strict=True)):
            if other != k:
                fate = meet_points(points, normals, seen_by, composed(inverse(at), place), NARROW * view.grain)
                seen += fate >= 0
                through += fate == LOOKED_THROUGH
        kept = there.copy()
        kept[there] = (seen >= through) & (seen >= (1 if len(views) >= _FEWEST else 0))
        found.append(without_crumbs(kept))
    return found
