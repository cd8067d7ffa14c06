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
from calib.registration.range_view import Surfaces, pixel_under, rotate_vector

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
_LIKE = float(np.cos(np.radians(35.0)))
_CONTRADICTS, _HIDDEN, _FATES = 0, 1, 2


@dataclass(frozen=True)
class Agreement:
    """Of K poses. `matched` (K, P + 1, Q + 1): patches that agree, by the planes in either station they are on, the
    last for none; `contradicting`, `hidden` (K,): patches. `keypoints` (K,): those of the pictures that agree.
    """

    matched: Ints
    contradicting: Ints
    hidden: Ints
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


def _nats_of_keypoints(count: Ints) -> Floats:
    return np.clip(_NATS_PER_KEYPOINT * (count - _MARKS_BY_CHANCE), 0.0, _MOST_NATS_OF_MARKS)


def nats_of_tilt(poses: Pose) -> Floats:
    """What it costs that cameras are tilted against each other, for each of the poses between them, (...,)."""
    angle = np.arccos(np.clip(poses.rotation[..., 1, 1], -1, 1))
    cost: Floats = 0.5 * (angle / _UPRIGHT_SIGMA) ** 2
    return cost


def compare(
    first: Surfaces,
    second: Surfaces,
    poses: Pose,
    tolerance: float,
    patches: int | None = None,
) -> Agreement:
    """At K poses X_first = R X_second + t; `patches`: how many of each station are compared, None for all."""
    count = len(poses.translation)
    matched = np.zeros((count, len(first.planes) + 1, len(second.planes) + 1), np.int64)
    fates = np.zeros((count, _FATES), np.int64)
    _look(second, first, poses, tolerance, patches, matched.transpose(0, 2, 1), fates)
    _look(first, second, poses.inverse(), tolerance, patches, matched, fates)
    keypoints = _keypoints(first, second, poses, tolerance)
    return Agreement(matched, fates[:, _CONTRADICTS], fates[:, _HIDDEN], keypoints)


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


def _look(
    patches_of: Surfaces,
    seen_by: Surfaces,
    poses: Pose,
    tolerance: float,
    count: int | None,
    matched: Ints,
    fates: Ints,
) -> None:
    """`matched` (K, planes of the patches + 1, planes of the camera + 1) and `fates` (K, 3) are added to."""
    counted = np.zeros_like(matched, order="C")
    _look_through(
        patches_of.patches[:count],
        patches_of.patch_normals[:count],
        patches_of.patch_labels[:count],
        np.ascontiguousarray(poses.rotation),
        poses.translation,
        seen_by.points,
        seen_by.normals,
        seen_by.labels,
        seen_by.near,
        seen_by.lens,
        tolerance,
        3 * (seen_by.noise + patches_of.noise),
        counted,
        fates,
    )
    matched += counted


@compiled
def _look_through(
    patches: Floats,
    patch_normals: Floats,
    patch_labels: Ints,
    rotations: Floats,
    translations: Floats,
    points: Floats,
    normals: Floats,
    labels: Ints,
    near: Floats,
    lens: Floats,
    tolerance: float,
    noise: float,
    matched: Ints,
    fates: Ints,
) -> None:
    height, width = labels.shape
    for k in range(len(rotations)):
        r, t = rotations[k], translations[k]
        for m in range(len(patches)):
            x, y, z = rotate_vector(r, patches[m])
            x, y, z = x + t[0], y + t[1], z + t[2]
            i, j = pixel_under(x, y, z, lens, height, width)
            if i < 0:
                continue
            depth = points[i, j, 2]
            if not depth > 0:
                continue
            within = depth * (tolerance + noise * depth)
            p, q, s = normals[i, j, 0], normals[i, j, 1], normals[i, j, 2]
            off = p * (x - points[i, j, 0]) + q * (y - points[i, j, 1]) + s * (z - depth)
            e, f, g = rotate_vector(r, patch_normals[m])
            like = p * e + q * f + s * g
            if np.abs(off) < within and np.abs(z - depth) < 6 * within:
                if like > _LIKE:
                    matched[k, patch_labels[m], labels[i, j]] += 1
            elif z < near[i, j] - within - _FREE * depth:
                fates[k, _CONTRADICTS] += 1
            elif z > depth:
                fates[k, _HIDDEN] += 1
