"""Poses of one view on another without an initial guess: from all rotations, and from keypoints in the pictures.

Descriptors of the surface's shape (FPFH) need detail that smooth things lack. A descent costs some tens of
microseconds, so it can start from every rotation, judged by the patches that match. The initial translation aligns the
points where the normals of each view converge.
"""

import numpy as np

from calib.geometry import IDENTITY, Pose
from calib.numerics import Bools, Floats
from calib.objects.joint import align
from calib.objects.patch_overlap import WIDE
from calib.objects.view import ObjectView
from calib.registration import Gates, descend, distinct_poses, even_rotations, voted_poses

_TURNS = 1200  # rotations; any rotation is about 17° from the nearest one
# Numbers of patches, and distances in grains within which they match: for all descents, and for the best.
_WIDELY, _WIDE = 200, np.array([8.0, 8.0, 6.0, 6.0, 4.0, 4.0, 3.0, 3.0, 2.0, 2.0])
_CLOSELY, _CLOSE = 500, np.array([2.0, 1.5, 1.5, 1.0, 1.0, 0.7, 0.5, 0.5])
_DISTINCT = 60
THOROUGHLY = 600  # distinct descents that are refined if the best few leave a view out
_SAME_TURN, _SAME_GRAINS = np.radians(6.0), 8.0
_GATES = Gates(False, 3.0, float(np.cos(np.radians(50.0))), beyond=1.0, free=0.0, off=0.0, shows_backs=False)
_BEHIND = 20.0  # grains


def searched_poses(first: ObjectView, second: ObjectView, most: int, followed: int = _DISTINCT) -> list[Pose]:
    """X_first = R X_second + t, no two about the same; the `most` that meet most, the best first.

    `followed`: how many distinct poses of the wide descents descend closely. Where views share little, wrong poses meet
    more of the surface than the right one does, though not as closely: it is then among the first few hundred.
    """
    turns = even_rotations(_TURNS)
    starts = Pose(turns, normal_centre(first) - turns @ normal_centre(second))
    wide = _descended(first, second, starts, _WIDELY, _WIDE, followed)
    close = _descended(first, second, wide, _CLOSELY, _CLOSE, most)
    return [close[k] for k in range(len(close.translation))]


def _descended(first: ObjectView, second: ObjectView, starts: Pose, patches: int, rounds: Floats, most: int) -> Pose:
    """The best distinct poses (K,) after the descents, best first."""
    # What is not known to be behind a patch counts as free: a pose that puts the thing there is no better for it.
    image = first.image._replace(depth=first.image.near)
    some = second.patches.first(patches)
    poses, worth = descend(image, some, starts, _GATES, first.grain * rounds, normal_centre(first))
    return poses[distinct_poses(poses, worth, _SAME_TURN, _SAME_GRAINS * first.grain, most)]


def are_about_the_same(poses: Pose, reference: Pose, grain: float) -> Bools:
    """Which poses a descent would not tell from a reference, (...,)."""
    return poses.is_near(reference, _SAME_TURN, _SAME_GRAINS * grain)


def normal_centre(view: ObjectView) -> Floats:
    """The point (3,) that the lines along all patches' normals come closest to: the middle, if the thing is round."""
    return view.patches.normal_centre(_BEHIND * view.grain)


_SEARCHED = 8
_SOME = 250  # patches
_COMPATIBLE, _FAR = 1.5, 5.0  # grains: largest difference of distances, and least distance of points


def suggested_poses(first: ObjectView, second: ObjectView, *, thorough: bool = False) -> list[Pose]:
    """X_first = R X_second + t, within a grain or so; and that hardly anything moved.

    `thorough`: all that a longer search finds, some hundreds, instead of those that meet most.
    """
    if thorough:
        return searched_poses(first, second, THOROUGHLY, THOROUGHLY)
    within, far, alike = _COMPATIBLE * first.grain, _FAR * first.grain, (_SAME_TURN, _SAME_GRAINS * first.grain)
    by_keypoints = voted_poses(first.keypoints, second.keypoints, within, far, alike)
    rough = [align(first, second, pose, (WIDE, 1.0), _SOME) for pose in (IDENTITY, *by_keypoints)]
    return [*rough, *searched_poses(first, second, _SEARCHED)]
