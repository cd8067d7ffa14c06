"""Poses of one view on another without an initial guess: from all rotations, and from keypoints in the pictures.

Descriptors of the surface's shape (FPFH) need detail that smooth things lack. A descent costs some tens of
microseconds, so it can start from every rotation, judged by the patches that match. The initial translation aligns the
points where the normals of each view converge.

Most matching keypoints (SIFT: Lowe 2004) are wrong. A rigid motion preserves distances, so right pairs are compatible
with each other; pairs that are compatible with the same others vote for one pose (Chen et al., "SC²-PCR: a second order
spatial compatibility for efficient and robust point cloud registration", 2022).
"""

import numpy as np

from calib.geometry import IDENTITY, Pose
from calib.numerics import Bools, Floats, distinct
from calib.objects.joint import WIDE, align
from calib.objects.patch_overlap import mark_pairs
from calib.objects.view import ObjectView
from calib.registration import Gates, descend, even_rotations, fit_rigid_motion

_TURNS = 1200  # rotations; any rotation is about 17° from the nearest one
# Numbers of patches, and distances in grains within which they match: for all descents, and for the best.
_WIDELY, _WIDE = 200, np.array([8.0, 8.0, 6.0, 6.0, 4.0, 4.0, 3.0, 3.0, 2.0, 2.0])
_CLOSELY, _CLOSE = 500, np.array([2.0, 1.5, 1.5, 1.0, 1.0, 0.7, 0.5, 0.5])
_DISTINCT = 60
THOROUGHLY = 600  # distinct descents that are refined if the best few leave a view out
_SAME_TURN, _SAME_GRAINS = np.radians(6.0), 8.0
_GATES = Gates(False, 3.0, float(np.cos(np.radians(50.0))), beyond=1.0, free=0.0, off=0.0, shows_backs=False)
_TOWARDS_MIDDLE = 0.1  # share of a patch's weight by which a centre is drawn to a point behind the visible surface
_BEHIND = 20.0  # grains


def searched_poses(first: ObjectView, second: ObjectView, most: int, followed: int = _DISTINCT) -> list[Pose]:
    """X_first = R X_second + t, no two about the same; the `most` that meet most, the best first.

    `followed`: how many distinct poses of the wide descents descend closely. Where views share little, wrong poses meet
    more of the surface than the right one does, though not as closely: it is then among the first few hundred.
    """
    turns = even_rotations(_TURNS)
    starts = Pose(turns, normal_centre(first) - turns @ normal_centre(second))
    wide = _distinct(_descended(first, second, starts, _WIDELY, _WIDE), first.grain, followed)
    return _distinct(_descended(first, second, Pose.stack(wide), _CLOSELY, _CLOSE), first.grain, most)


def _descended(first: ObjectView, second: ObjectView, starts: Pose, patches: int, rounds: Floats) -> Pose:
    """The poses (K,) after the descents, best first."""
    # What is not known to be behind a patch counts as free: a pose that puts the thing there is no better for it.
    image = first.image._replace(depth=first.image.near)
    some = second.patches.first(patches)
    poses, worth = descend(image, some, starts, _GATES, first.grain * rounds, normal_centre(first))
    return poses[np.argsort(-worth)]


def _distinct(poses: Pose, grain: float, most: int) -> list[Pose]:
    chosen = distinct(len(poses.translation), lambda k: are_about_the_same(poses, poses[k], grain), most)
    return [poses[k] for k in chosen]


def are_about_the_same(poses: Pose, reference: Pose, grain: float) -> Bools:
    """Which poses a descent would not tell from a reference, (...,)."""
    return poses.is_near(reference, _SAME_TURN, _SAME_GRAINS * grain)


def normal_centre(view: ObjectView) -> Floats:
    """The point (3,) that the lines along all patches' normals come closest to: the middle, if the thing is round."""
    across = np.eye(3) - view.patches.normals[:, :, None] * view.patches.normals[:, None]
    middle = view.patches.points.mean(axis=0)
    behind = middle * (1 + _BEHIND * view.grain / float(np.linalg.norm(middle)))
    drawn = _TOWARDS_MIDDLE * len(across)
    pull = np.einsum("nij,nj->i", across, view.patches.points) + drawn * behind
    return np.linalg.solve(across.sum(axis=0) + drawn * np.eye(3), pull)


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
