"""Supposed relative poses of two stations: from their planes, from keypoints of their pictures, from their shape.

All of these are judged by how the stations' surfaces agree and contradict each other (agreement.py), the best are
refined and judged again. Plain walls have no features of shape; objects do.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry import IDENTITY, Pose
from calib.registration.agreement import COARSE, FINE, compare, compare_one, gain, nats_of_tilt
from calib.registration.alignment import align, normal_equations
from calib.registration.keypoints import voted_poses
from calib.registration.range_view import Surfaces
from calib.registration.sampled_surface import extent_of, sample_surface
from calib.registration.starting_poses import LEAST_SINE, distinct_poses, poses_by_planes
from calib.registration.surface_hypotheses import surface_poses

_SAME_ROTATION, _SAME_PLACE = np.radians(5.0), 0.04  # radians; relative to the distance
_COARSE_PATCHES, _SETTLING_PATCHES = 150, 500
_REFINED, _KEPT = 40, 12
_LEAST_NATS = 3.0
_SLIDES = np.array(
    [0.0, -0.04, -0.03, -0.02, -0.01, 0.01, 0.02, 0.03, 0.04]
)  # over the distance; the first is no shift
_HOLDING_PATCHES = 20


@dataclass(frozen=True)
class Hypothesis:
    """X_first = R X_second + t, the evidence of the overlap in nats, and the contradicting share."""

    pose: Pose
    nats: float
    contradiction: float


def hypotheses(first: Surfaces, second: Surfaces) -> list[Hypothesis]:
    """Relative poses of two stations that are worth following up, best first.

    Keypoints of the pictures suggest some. Shape descriptors are asked where planes are too few to fix a pose; and the
    rig may hardly have been moved at all.
    """
    reach = 1.2 * (first.distance + second.distance)
    by_planes = poses_by_planes((first.planes, first.plane_area), (second.planes, second.plane_area), reach)
    further = [IDENTITY, *keypoint_poses(first, second)]
    if min(_fixed_directions(first), _fixed_directions(second)) < 3:
        further += shape_poses(first, second)
    poses = Pose.concatenate([by_planes, Pose.stack(further)])
    coarse = compare(first, second, poses, COARSE, _COARSE_PATCHES)
    thinned = max(1.0, len(first.patches.points) / _COARSE_PATCHES)
    worth = gain([coarse], thinned) - nats_of_tilt(poses)
    worth[len(worth) - len(further) :] += 1e6  # they are few, and each is evaluated
    size = _SAME_PLACE * (first.distance + second.distance) / 2
    judgements = []
    for k in distinct_poses(poses, worth, _SAME_ROTATION, size, _REFINED):
        pose = refined(first, second, poses[k])
        judgements.append(judged(first, second, _slid(first, second, pose)))
    judgements.sort(key=lambda hypothesis: -hypothesis.nats)
    nats = np.array([hypothesis.nats for hypothesis in judgements])
    poses = Pose.stack([hypothesis.pose for hypothesis in judgements])
    kept = distinct_poses(poses, nats, _SAME_ROTATION, size, _KEPT)
    return [judgements[k] for k in kept if judgements[k].nats > _LEAST_NATS]


def _fixed_directions(surfaces: Surfaces) -> int:
    """In how many directions a station's planes hold it."""
    normals = surfaces.planes[surfaces.plane_area > _HOLDING_PATCHES, :3]
    return int(np.count_nonzero(np.linalg.svd(normals, compute_uv=False) > LEAST_SINE)) if len(normals) else 0


def refined(first: Surfaces, second: Surfaces, pose: Pose) -> Pose:
    """The pose at which the second station's surfaces fit the first one's."""
    return align(second, pose, [(first, IDENTITY)], (COARSE, FINE), _SETTLING_PATCHES)


def _slid(first: Surfaces, second: Surfaces, pose: Pose) -> Pose:
    """The pose, or a likelier one a little further along the direction that holds the second station least: what holds
    it there, the side of a cupboard, may have been too far off to be found.
    """
    shifts = normal_equations(second, pose, first, IDENTITY, FINE, _SETTLING_PATCHES).matrix[3:, 3:]
    along = np.linalg.eigh(shifts)[1][:, 0]
    steps = _SLIDES * (first.distance + second.distance) / 2
    poses = Pose(np.broadcast_to(pose.rotation, (len(steps), 3, 3)), pose.translation + steps[:, None] * along)
    best = int(np.argmax(gain([compare(first, second, poses, FINE)])))
    if steps[best] == 0.0:
        return pose
    return align(second, poses[best], [(first, IDENTITY)], (FINE,), _SETTLING_PATCHES)


def judged(first: Surfaces, second: Surfaces, pose: Pose) -> Hypothesis:
    """What is to be thought of a pose."""
    agreement = compare_one(first, second, pose)
    nats = float(gain([agreement])[0] - nats_of_tilt(pose))
    return Hypothesis(pose, nats, float(agreement.contradiction[0]))


_WIDEST = 0.1  # relative to the depth: closer keypoints do not determine a rotation
_FEWEST = 5


def keypoint_poses(first: Surfaces, second: Surfaces) -> list[Pose]:
    """Poses X_first = R X_second + t with the most coinciding keypoints; none with fewer than five."""
    distance = (first.distance + second.distance) / 2
    alike = _SAME_ROTATION, _SAME_PLACE * distance
    return voted_poses(first.keypoints, second.keypoints, COARSE * distance, _WIDEST * distance, alike, _FEWEST)


_CELLS_ACROSS = 50
_MOST_SHAPES = 10
_OUTSIDE = 0.05


def shape_poses(first: Surfaces, second: Surfaces) -> list[Pose]:
    """X_first = R X_second + t, by the shape of the surfaces. Raises ImportError where Open3D cannot be loaded."""
    cell = max(extent_of(side.patches.points, _OUTSIDE) for side in (first, second)) / _CELLS_ACROSS
    middles, samples = [], []
    for image in (first.image, second.image):
        there = np.isfinite(image.normals[..., 2])
        middles.append(np.median(image.points[there], axis=0))
        samples.append(sample_surface(image.points[there] - middles[-1], image.normals[there], cell, 0.0))
    (poses,) = surface_poses(samples[0], samples[1])
    to, of = (Pose(np.eye(3), middle) for middle in middles)
    return [to @ poses[k] @ of.inverse() for k in range(min(_MOST_SHAPES, len(poses.translation)))]
