"""Suggested relative poses from matching keypoints of two pictures: three random ones determine a pose.

Fischler and Bolles, "Random sample consensus", 1981; the pose through three points is Kabsch's (1976).
"""

import numpy as np

from calib.geometry import Pose, nearest_rotation
from calib.numerics import Bools, Floats
from calib.registration.agreement import COARSE
from calib.registration.keypoints import match_keypoints
from calib.registration.range_view import Surfaces

_DRAWN = 2000
_FEWEST = 5
_WIDEST = 0.1  # relative to the depth: closer keypoints do not determine a rotation
_ROUNDS = 3
_MOST = 3


def keypoint_poses(first: Surfaces, second: Surfaces) -> list[Pose]:
    """Poses X_first = R X_second + t with the most coinciding keypoints; none with fewer than five."""
    own, matching = match_keypoints(first.keypoints, second.keypoints)
    here, there = first.keypoints.points[own], second.keypoints.points[matching]
    poses: list[Pose] = []
    unused = np.ones(len(own), np.bool_)
    rng = np.random.default_rng(0)
    while len(poses) < _MOST and np.count_nonzero(unused) >= _FEWEST:
        pose, near = _likeliest(here[unused], there[unused], rng)
        if pose is None or np.count_nonzero(near) < _FEWEST:
            break
        poses.append(pose)
        unused[np.flatnonzero(unused)[near]] = False
    return poses


def _likeliest(here: Floats, there: Floats, rng: np.random.Generator) -> tuple[Pose | None, Bools]:
    """The pose that brings most points `there` (M, 3) to those `here`, and which of them (M,)."""
    within = COARSE * here[:, 2]
    three = rng.integers(0, len(here), (_DRAWN, 3))
    sides = [np.linalg.norm(points[three] - points[np.roll(three, 1, axis=1)], axis=2) for points in (here, there)]
    wide = sides[0].min(axis=1) > _WIDEST * float(np.median(here[:, 2]))
    three = three[wide & (np.abs(sides[0] - sides[1]).max(axis=1) < 2 * within[three].min(axis=1))]
    if len(three) == 0:
        return None, np.zeros(len(here), np.bool_)
    off = fit_rigid_motion(here[three], there[three]) @ there - here
    near = np.linalg.norm(off, axis=2) < within
    best = near[int(np.argmax(np.count_nonzero(near, axis=1)))]
    for _ in range(_ROUNDS):
        pose = fit_rigid_motion(here[best][None], there[best][None])[0]
        best = np.linalg.norm(pose @ there - here, axis=1) < within
        if np.count_nonzero(best) < 3:
            return None, best
    return pose, best


def fit_rigid_motion(here: Floats, there: Floats) -> Pose:
    """The poses (K,) that bring points `there` (K, M, 3) nearest to those `here`."""
    to, of = here.mean(axis=1), there.mean(axis=1)
    rotations = nearest_rotation(np.swapaxes(here - to[:, None], 1, 2) @ (there - of[:, None]))
    return Pose(rotations, to - np.einsum("kij,kj->ki", rotations, of))
