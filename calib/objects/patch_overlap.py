"""Where patches of one view meet another view at a supposed pose, and what that says for the pose and against it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.numerics import Floats, Ints, compiled
from calib.objects.view import ObjectView
from calib.registration import match_keypoints, pixel_under, rotate_vector

UNSEEN, HIDDEN, THROUGH_FREE_SPACE, OFF_SURFACE = -1, -2, -3, -4
_LIKE = float(np.cos(np.radians(40.0)))
_SIGMAS, _BENT = 4.0, 0.12  # the second in grains
_FREE = 1.5  # grains: closer than this in front of a surface, the other camera would have seen it


def overlapping_pixels(
    patches_of: ObjectView, seen_by: ObjectView, pose: Pose, within: float, count: int | None = None
) -> Ints:
    """For each patch (M,) the flat index of the pixel of `seen_by` whose surface it lies on, or the reason why there is
    none.

    `pose`: X_seen_by = R X_patches + t. `within`: tolerance of the distance from the surface, in the points' unit.
    """
    return overlapping_pixels_of_points(
        patches_of.patch_points[:count], patches_of.patch_normals[:count], seen_by, pose, within
    )


def overlapping_pixels_of_points(
    points: Floats, normals: Floats, seen_by: ObjectView, pose: Pose, within: float
) -> Ints:
    """The same for any points with normals, (N, 3) each."""
    found = np.empty(len(points), np.int64)
    _overlap(
        points,
        normals,
        np.ascontiguousarray(pose.rotation),
        pose.translation,
        seen_by.lens,
        seen_by.points,
        seen_by.normals,
        seen_by.depth,
        seen_by.near,
        within,
        _FREE * seen_by.grain,
        found,
    )
    return found


@compiled
def _overlap(
    patches: Floats,
    patch_normals: Floats,
    r: Floats,
    t: Floats,
    lens: Floats,
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    depth: NDArray[np.float32],
    near: NDArray[np.float32],
    within: float,
    free: float,
    found: Ints,
) -> None:
    height, width = depth.shape
    for m in range(len(patches)):
        found[m] = -1
        x, y, z = rotate_vector(r, patches[m])
        x, y, z = x + t[0], y + t[1], z + t[2]
        i, j = pixel_under(x, y, z, lens, height, width)
        if i < 0:
            continue
        n0, n1, n2 = rotate_vector(r, patch_normals[m])
        if n0 * x + n1 * y + n2 * z >= 0:  # it faces away from the camera, so it is the back of the thing
            continue
        if points[i, j, 2] > 0:
            k0, k1, k2 = normals[i, j, 0], normals[i, j, 1], normals[i, j, 2]
            off = k0 * (x - points[i, j, 0]) + k1 * (y - points[i, j, 1]) + k2 * (z - points[i, j, 2])
            like = n0 * k0 + n1 * k1 + n2 * k2
            if np.abs(off) < within and np.abs(z - points[i, j, 2]) < 4 * within and like > _LIKE:
                found[m] = i * width + j
                continue
            if np.abs(z - points[i, j, 2]) < free:
                found[m] = -4
                continue
        if depth[i, j] > 0:
            if z < near[i, j] - free:
                found[m] = -3
            elif z > depth[i, j]:
                found[m] = -2


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
    one, other = (float(np.median(view.sigma(view.patches))) for view in (first, second))
    return _SIGMAS * float(np.hypot(one, other)) + _BENT * first.grain


def evidence(
    first: ObjectView, second: ObjectView, pose: Pose, within: float, count: int | None = None
) -> OverlapEvidence:
    """For X_first = R X_second + t."""
    there = overlapping_pixels(second, first, pose, within, count)
    here = overlapping_pixels(first, second, pose.inverse(), within, count)
    both = np.concatenate([there, here])
    own, other = mark_pairs(first, second)
    apart = np.linalg.norm(pose @ second.keypoints.points[other] - first.keypoints.points[own], axis=1)
    return OverlapEvidence(
        int(np.count_nonzero(both >= 0)),
        int(np.count_nonzero((both == THROUGH_FREE_SPACE) | (both == OFF_SURFACE))),
        int(np.count_nonzero(apart < _MARK_GRAINS * first.grain)),
    )


def mark_pairs(first: ObjectView, second: ObjectView) -> tuple[Ints, Ints]:
    """Matching keypoints, (M,) of either view."""
    return match_keypoints(first.keypoints, second.keypoints)
