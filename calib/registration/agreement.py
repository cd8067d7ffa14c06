"""Agreement and contradiction of the surfaces of two stations at a suggested relative pose.

A patch of one station is seen from the other one's camera. If it lies on the measured surface with the same slope, it
agrees. If it lies well in front of that surface, it violates free space that the other camera saw, and contradicts. If
it is hidden or out of sight, it is neutral.

The evidence is in nats, as a description length. Common surfaces need fewer numbers: a plane that need not be described
again saves about log(size of a room / tolerance), however large it is, and slightly more for every patch, because each
could have contradicted. A patch on no plane saves little, because it resembles its neighbours. The pose has to be
described instead. Each contradicting patch has a cost. Matching keypoints of the pictures that coincide count likewise
along the planes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry import Pose
from calib.numerics import Floats, Ints, compiled
from calib.registration.keypoints import match_keypoints
from calib.registration.projection import THROUGH_FREE_SPACE, Gates, classify
from calib.registration.range_view import Surfaces

# Relative depth, beyond three sigmas of noise: error of a calibration, and of a pose before refinement.
FINE, COARSE = 0.012, 0.03
_FREE = 0.015  # a patch farther than this in front of a surface violates free space of the other camera
NATS_PER_PLANE, _PATCHES_PER_PLANE = 6.0, 10.0
_NATS_PER_PLANE_PATCH, NATS_PER_PATCH, NATS_PER_CONTRADICTION = 0.008, 0.1, 1.0
NATS_OF_POSE = 17.0
# Keypoints of a repeated pattern match by the dozen: the first few have no weight, and the total is limited.
_NATS_PER_KEYPOINT, _MARKS_BY_CHANCE, _MOST_NATS_OF_MARKS = 2.0, 4, 30.0
# The best solution must be 1000 times as likely as the next.
DECIDED_NATS = float(np.log(1000.0))
_UPRIGHT_SIGMA = np.radians(45.0)
GATES = Gates(True, 6.0, float(np.cos(np.radians(35.0))), beyond=1.0, free=_FREE, off=0.0, shows_backs=True)


@dataclass(frozen=True)
class Agreement:
    """Of K poses. `matched` (K, P + 1, Q + 1): patches that agree, by the planes in either station they are on, the
    last for none; `contradicting` (K,): patches. `keypoints` (K,): those of the pictures that agree.
    """

    matched: Ints
    contradicting: Ints
    keypoints: Ints

    @property
    def agreeing(self) -> Ints:
        """Patches of both stations that agree, (K,)."""
        count: Ints = self.matched.sum(axis=(1, 2))
        return count

    @property
    def contradiction(self) -> Floats:
        """Share of contradicting patches among those that say something, (K,)."""
        share: Floats = self.contradicting / np.maximum(self.agreeing + self.contradicting, 1)
        return share


def gain(agreements: Sequence[Agreement], thinned: float = 1.0) -> Floats:
    """Evidence for a station in nats, (K,), given several others, in K poses: as the second station of `agreements`.

    A plane that several others share counts once; any of them can contradict it. Keypoints count that it
    shares with one of them.
    """
    on_planes = sum(agreement.matched[:, :-1, :-1].sum(axis=1) for agreement in agreements) * thinned
    planes = NATS_PER_PLANE * np.sum(1 - np.exp(-on_planes / _PATCHES_PER_PLANE), axis=1)
    shared = np.stack([agreement.matched[:, :-1, :-1].sum(axis=(1, 2)) for agreement in agreements])
    off_planes = np.stack([agreement.agreeing for agreement in agreements]) - shared
    against = sum(agreement.contradicting for agreement in agreements)
    worth: Floats = planes + thinned * (
        np.max(_NATS_PER_PLANE_PATCH * shared + NATS_PER_PATCH * off_planes, axis=0) - NATS_PER_CONTRADICTION * against
    )
    with_keypoints: Floats = worth + np.max(
        [_nats_of_keypoints(agreement.keypoints) for agreement in agreements], axis=0
    )
    return with_keypoints


def nats_of_place(agreements: Sequence[Agreement], poses: Sequence[Pose]) -> float:
    """Evidence in nats for the place of a station, or of a part of a group, at the poses (one by one) of its
    `agreements` with the others.
    """
    return float(gain(agreements)[0]) - min(float(nats_of_tilt(pose)) for pose in poses) - NATS_OF_POSE


def _nats_of_keypoints(count: Ints) -> Floats:
    return np.clip(_NATS_PER_KEYPOINT * (count - _MARKS_BY_CHANCE), 0.0, _MOST_NATS_OF_MARKS)


def nats_of_tilt(poses: Pose) -> Floats:
    """What it costs that cameras are tilted against each other, for each of the poses between them, (...,)."""
    angle = np.arccos(np.clip(poses.rotation[..., 1, 1], -1, 1))
    cost: Floats = 0.5 * (angle / _UPRIGHT_SIGMA) ** 2
    return cost


def compare(first: Surfaces, second: Surfaces, poses: Pose, tolerance: float, patches: int | None = None) -> Agreement:
    """At K poses X_first = R X_second + t; `patches`: how many of each station are compared, None for all."""
    matched, contradicting = _seen_by(first, second, poses, tolerance, patches)
    back, also = _seen_by(second, first, poses.inverse(), tolerance, patches)
    matched = matched.transpose(0, 2, 1) + back
    return Agreement(matched, contradicting + also, _keypoints(first, second, poses, tolerance))


def _seen_by(camera: Surfaces, moved: Surfaces, poses: Pose, tolerance: float, count: int | None) -> tuple[Ints, Ints]:
    """Patches that agree (K, planes of what is moved + 1, planes of the camera's station + 1), and that contradict."""
    noise = 3 * (camera.noise + moved.noise)
    fates = classify(camera.image, moved.patches.first(count), poses, GATES, tolerance, noise)
    matched = np.zeros((len(fates), len(moved.planes) + 1, len(camera.planes) + 1), np.int64)
    contradicting = np.zeros(len(fates), np.int64)
    _count(fates, moved.patch_labels, camera.labels.ravel(), THROUGH_FREE_SPACE, matched, contradicting)
    return matched, contradicting


@compiled
def _count(fates: Ints, patch_labels: Ints, labels: Ints, contradicts: int, matched: Ints, contradicting: Ints) -> None:
    for k in range(len(fates)):
        for m in range(fates.shape[1]):
            if fates[k, m] >= 0:
                matched[k, patch_labels[m], labels[fates[k, m]]] += 1
            elif fates[k, m] == contradicts:
                contradicting[k] += 1


def _keypoints(first: Surfaces, second: Surfaces, poses: Pose, tolerance: float) -> Ints:
    """Number of matching keypoints that coincide, (K,)."""
    own, matching = match_keypoints(first.keypoints, second.keypoints)
    if len(own) <= _MARKS_BY_CHANCE:
        return np.zeros(len(poses.translation), np.int64)
    here, there = first.keypoints.points[own], second.keypoints.points[matching]
    off = poses @ there - here
    count: Ints = np.count_nonzero(np.linalg.norm(off, axis=2) < tolerance * here[:, 2], axis=1)
    return count


def compare_one(first: Surfaces, second: Surfaces, pose: Pose) -> Agreement:
    """At one pose, all patches at the fine tolerance."""
    return compare(first, second, pose[None], FINE)
