"""Where patches of one view meet another view at a pose: what that says for the pose and against it, and which pixels
other views confirm once poses are known. The rest is background, or an error.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.numerics import Bools, Ints
from calib.objects.view import ObjectView, without_small_pieces
from calib.registration import OFF_SURFACE, THROUGH_FREE_SPACE, Gates, Patches, classify, match_keypoints

WIDE, NARROW = 3.0, 0.6  # grains, within which surfaces coincide: of rough poses, and of good ones
_LIKE = float(np.cos(np.radians(40.0)))
_SIGMAS, _BENT = 4.0, 0.12  # the second in grains
_FREE = 1.5  # grains: closer than this in front of a surface, the other camera would have seen it


def overlapping_pixels(patches: Patches, seen_by: ObjectView, pose: Pose, within: float) -> Ints:
    """For each patch (M,) the flat index of the pixel of `seen_by` whose surface it lies on, or the reason why there is
    none, as of `classify`.

    `pose`: X_seen_by = R X_patches + t. `within`: tolerance of the distance from the surface, in the points' unit.
    """
    free = _FREE * seen_by.grain
    gates = Gates(False, 4.0, _LIKE, beyond=0.0, free=free, off=free, shows_backs=False)
    fates: Ints = classify(seen_by.image, patches, pose[None], gates, within)[0]
    return fates


@dataclass(frozen=True)
class OverlapEvidence:
    """Counts over the patches of both views: `agreeing`, `against` (violating free space, or off the surface), and
    matching `keypoints` of the pictures that coincide.
    """

    agreeing: int
    against: int
    keypoints: int

    @property
    def worth(self) -> float:
        """In patches. Wrong poses agree for the most part, too: one against outweighs several. Keypoints weigh much."""
        return self.agreeing - _PER_AGAINST * self.against + _PER_KEYPOINT * max(0, self.keypoints - _BY_CHANCE)

    @property
    def share(self) -> float:
        """Of what could agree."""
        return self.agreeing / max(1, self.agreeing + self.against)


_PER_AGAINST, _PER_KEYPOINT, _BY_CHANCE = 3.0, 25.0, 4
_MARK_GRAINS = 1.0


def tolerance(first: ObjectView, second: ObjectView) -> float:
    """Largest distance of coinciding surfaces: noise, and a small calibration error."""
    first_sigma, second_sigma = (float(np.median(view.sigma(view.pixel))) for view in (first, second))
    return _SIGMAS * float(np.hypot(first_sigma, second_sigma)) + _BENT * first.grain


def evidence(
    first: ObjectView, second: ObjectView, pose: Pose, within: float, count: int | None = None
) -> OverlapEvidence:
    """For X_first = R X_second + t."""
    there = overlapping_pixels(second.patches.first(count), first, pose, within)
    here = overlapping_pixels(first.patches.first(count), second, pose.inverse(), within)
    both = np.concatenate([there, here])
    own, matched = match_keypoints(first.keypoints, second.keypoints)
    apart = np.linalg.norm(pose @ second.keypoints.points[matched] - first.keypoints.points[own], axis=1)
    return OverlapEvidence(
        int(np.count_nonzero(both >= 0)),
        int(np.count_nonzero((both == THROUGH_FREE_SPACE) | (both == OFF_SURFACE))),
        int(np.count_nonzero(apart < _MARK_GRAINS * first.grain)),
    )


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
    confirmations = []
    for k, (view, place) in enumerate(zip(views, places, strict=True)):
        there = np.isfinite(view.image.points[..., 2])
        patches = Patches(*(values[there].astype(np.float64) for values in view.image[:2]))
        met_by, through = np.zeros((2, len(patches.points)), np.int64)
        total = np.zeros(len(patches.points))
        for viewer, (seen_by, at) in enumerate(zip(views, places, strict=True)):
            if viewer != k:
                to_other = at.inverse() @ place
                overlap = overlapping_pixels(patches, seen_by, to_other, NARROW * view.grain)
                met = np.flatnonzero(overlap >= 0)
                moved = to_other @ patches.points[met]
                theirs, towards = (values.reshape(-1, 3)[overlap[met]] for values in seen_by.image[:2])
                total[met] += np.sum(towards * (moved - theirs), axis=1)
                met_by[met] += 1
                through += overlap == THROUGH_FREE_SPACE
        kept = there.copy()
        kept[there] = (met_by >= through) & (met_by >= (1 if len(views) >= _FEWEST else 0))
        of_thing = without_small_pieces(kept)
        apart = np.full(there.shape, np.nan, np.float32)
        with np.errstate(invalid="ignore"):
            apart[there] = total / met_by
        confirmations.append(Confirmation(of_thing, np.where(of_thing, apart, np.float32(np.nan))))
    return confirmations
