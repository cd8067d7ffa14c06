"""Poses that most matching keypoints of two pictures agree on.

Most matches (SIFT: Lowe 2004) are wrong. A rigid motion preserves distances, so right pairs are compatible with each
other; pairs that are compatible with the same others vote for one pose (Chen et al., "SC²-PCR: a second order spatial
compatibility for efficient and robust point cloud registration", 2022), by Kabsch's solution of 1976.
"""

import numpy as np

from calib.geometry import Pose, nearest_rotation
from calib.numerics import Floats
from calib.registration.keypoints import Keypoints, match_keypoints

_SEEDS, _VOTERS, _KEPT, _ROUNDS = 30, 12, 6, 2


def fit_rigid_motion(here: Floats, there: Floats) -> Pose:
    """The poses (K,) that bring points `there` (K, M, 3) nearest to those `here`."""
    to, of = here.mean(axis=1), there.mean(axis=1)
    rotations = nearest_rotation(np.swapaxes(here - to[:, None], 1, 2) @ (there - of[:, None]))
    return Pose(rotations, to - np.einsum("kij,kj->ki", rotations, of))


def voted_poses(
    first: Keypoints, second: Keypoints, within: float, far: float, alike: tuple[float, float], fewest: int = 3
) -> list[Pose]:
    """X_first = R X_second + t at which at least the `fewest` keypoints coincide `within` a distance, most first.

    `far`: least distance of keypoints that vote together; `alike`: turn in radians and shift that two poses differ by.
    """
    own, matching = match_keypoints(first, second)
    if len(own) < fewest:
        return []
    here, there = first.points[own], second.points[matching]
    apart, beyond = (np.linalg.norm(side[:, None] - side, axis=2) for side in (here, there))
    compatible = ((np.abs(apart - beyond) < within) & (np.minimum(apart, beyond) > far)).astype(np.float32)
    votes = compatible * (compatible @ compatible)
    ranked: list[tuple[int, Pose]] = []
    for seed in np.argsort(-votes.sum(axis=1))[:_SEEDS]:
        voters = np.argsort(-votes[seed])[:_VOTERS]
        near = np.append(voters[votes[seed][voters] > 0], seed)
        for _ in range(_ROUNDS + 1):
            if len(near) < fewest:
                break
            pose = fit_rigid_motion(here[near][None], there[near][None])[0]
            near = np.flatnonzero(np.linalg.norm(pose @ there - here, axis=1) < within)
        if len(near) >= fewest and not any(pose.is_near(better, *alike) for _, better in ranked):
            ranked.append((len(near), pose))
    return [pose for _, pose in sorted(ranked, key=lambda vote: -vote[0])[:_KEPT]]
