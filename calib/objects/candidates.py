"""Suggested poses of two views without an initial guess: from their surfaces at every rotation, and from keypoints in
the pictures.

Most matching keypoints (SIFT: Lowe 2004) are wrong. A rigid motion preserves distances, so right pairs are compatible
with each other; pairs that are compatible with the same others vote for one pose (Chen et al., "SC²-PCR: a second order
spatial compatibility for efficient and robust point cloud registration", 2022).
"""

import numpy as np

from calib.geometry import IDENTITY, Pose
from calib.numerics import Floats
from calib.objects.joint import WIDE, align
from calib.objects.patch_overlap import mark_pairs
from calib.objects.pose_search import THOROUGHLY, are_about_the_same, searched_poses
from calib.objects.view import ObjectView
from calib.registration import fit_rigid_motion

_SEARCHED = 8
_SOME = 250  # patches
_COMPATIBLE, _FAR = 1.5, 5.0  # grains: largest difference of distances, and least distance of points
_SEEDS, _VOTERS, _KEPT = 30, 12, 6
_FEWEST = 3


def suggested_poses(first: ObjectView, second: ObjectView, *, thorough: bool = False) -> list[Pose]:
    """X_first = R X_second + t, within a grain or so; and that hardly anything moved.

    `thorough`: all that a longer search finds, some hundreds, instead of those that meet most.
    """
    if thorough:
        return searched_poses(first, second, THOROUGHLY, THOROUGHLY)
    own, other = mark_pairs(first, second)
    by_keypoints = _voted(first.keypoints.points[own], second.keypoints.points[other], first.grain)
    rough = [align(first, second, pose, (WIDE, 1.0), _SOME) for pose in (IDENTITY, *by_keypoints)]
    return [*rough, *searched_poses(first, second, _SEARCHED)]


def _voted(here: Floats, there: Floats, grain: float) -> list[Pose]:
    """Of pairs of points (N, 3)."""
    if len(here) < _FEWEST:
        return []
    apart, beyond = (np.linalg.norm(each[:, None] - each, axis=2) for each in (here, there))
    compatible = (np.abs(apart - beyond) < _COMPATIBLE * grain) & (np.minimum(apart, beyond) > _FAR * grain)
    first = compatible.astype(np.float32)
    second = first * (first @ first)
    found: list[tuple[int, Pose]] = []
    for seed in np.argsort(-second.sum(axis=1))[:_SEEDS]:
        voters = np.argsort(-second[seed])[:_VOTERS]
        voters = np.append(voters[second[seed][voters] > 0], seed)
        if len(voters) < _FEWEST:
            continue
        pose = fit_rigid_motion(here[voters][None], there[voters][None])[0]
        for _ in range(2):
            near = np.linalg.norm(pose @ there - here, axis=1) < _COMPATIBLE * grain
            if np.count_nonzero(near) >= _FEWEST:
                pose = fit_rigid_motion(here[near][None], there[near][None])[0]
        if not any(are_about_the_same(pose, better, grain) for _, better in found):
            found.append((int(np.count_nonzero(near)), pose))
    return [pose for _, pose in sorted(found, key=lambda each: -each[0])[:_KEPT]]
