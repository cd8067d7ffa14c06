"""Supposed relative poses of two stations: from their planes, from keypoints of their pictures, from their shape.

Two pairs of planes that enclose like angles give a rotation; in a room there are few, for most planes are square to
each other. Given the rotation, each pair of planes with like normals fixes the translation along its normal: three of
them fix it, two leave it open along a line, which is then searched in steps. All of these are judged by how the
stations' surfaces agree and contradict each other (agreement.py), the best are refined and judged again.

Three matching keypoints of two pictures determine a pose (Fischler and Bolles, "Random sample consensus", 1981;
Kabsch, 1976). Without planes and pictures, Open3D's FPFH with RANSAC suggests one (Rusu et al., "Fast point feature
histograms (FPFH) for 3D registration", 2009): plain walls have no such features; objects do.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from calib.deferred_imports import open3d
from calib.geometry import IDENTITY, Pose, nearest_rotation
from calib.numerics import Bools, Floats, Ints, distinct
from calib.registration.agreement import COARSE, FINE, compare, compare_one, gain, nats_of_tilt
from calib.registration.alignment import align, normal_equations
from calib.registration.keypoints import match_keypoints
from calib.registration.range_view import Surfaces

_MOST_PLANES = 14
_LIKE_ANGLES = np.radians(4.0)
_LIKE_NORMALS = float(np.cos(np.radians(6.0)))
_LEAST_SINE = 0.4
_SAME_ROTATION, _SAME_PLACE = np.radians(5.0), 0.04  # radians; relative to the distance
_MOST_ROTATIONS, _MOST_PAIRS_OF_PLANES, _MOST_TRIPLES, _MOST_LINES, _LINE_STEPS = 16, 40, 1500, 12, 100
_MOST_TILTED = 24  # rotations of a cube onto itself
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
    by_planes, further = _suggested(first, second), [IDENTITY, *keypoint_poses(first, second)]
    if min(_fixed_directions(first), _fixed_directions(second)) < 3:
        further += shape_poses(first, second)
    poses = Pose.concatenate([by_planes, Pose.stack(further)])
    coarse = compare(first, second, poses, COARSE, _COARSE_PATCHES)
    thinned = max(1.0, len(first.patches.points) / _COARSE_PATCHES)
    worth = gain([coarse], thinned) - nats_of_tilt(poses)
    worth[len(worth) - len(further) :] += 1e6  # they are few, and each is evaluated
    size = _SAME_PLACE * (first.distance + second.distance) / 2
    judgements = []
    for k in _distinct(poses, worth, size, _REFINED):
        pose = refined(first, second, poses[k])
        judgements.append(judged(first, second, _slid(first, second, pose)))
    judgements.sort(key=lambda hypothesis: -hypothesis.nats)
    nats = np.array([hypothesis.nats for hypothesis in judgements])
    kept = _distinct(Pose.stack([hypothesis.pose for hypothesis in judgements]), nats, size, _KEPT)
    return [judgements[k] for k in kept if judgements[k].nats > _LEAST_NATS]


def _fixed_directions(surfaces: Surfaces) -> int:
    """In how many directions a station's planes hold it."""
    normals = surfaces.planes[surfaces.plane_area > _HOLDING_PATCHES, :3]
    return int(np.count_nonzero(np.linalg.svd(normals, compute_uv=False) > _LEAST_SINE)) if len(normals) else 0


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


def _distinct(poses: Pose, worth: Floats, size: float, most: int) -> list[int]:
    """Indices of the best of K poses, each unlike the better ones."""
    order = np.argsort(-worth, kind="stable")
    ordered = poses[order]
    alike = distinct(len(order), lambda k: ordered.is_near(ordered[k], _SAME_ROTATION, size), most)
    return [int(order[k]) for k in alike]


def _suggested(first: Surfaces, second: Surfaces) -> Pose:
    """Poses (K,) from planes."""
    reach = 1.2 * (first.distance + second.distance)
    return poses_by_planes((first.planes, first.plane_area), (second.planes, second.plane_area), reach)


def poses_by_planes(
    first: tuple[Floats, Ints], second: tuple[Floats, Ints], reach: float, *, is_upright: bool = True
) -> Pose:
    """Poses (K,) X_first = R X_second + t that bring planes onto planes.

    Each scene has its planes (P, 4), unit normals with offsets n · x, and their areas (P,), in any unit. `reach`:
    length of the longest translation. `is_upright`: rotations that tilt cameras, whose y axes point down, are less
    likely.
    """
    largest = [np.argsort(-area, kind="stable")[:_MOST_PLANES] for _, area in (first, second)]
    a, b = (planes[order] for (planes, _), order in zip((first, second), largest, strict=True))
    area = np.minimum(first[1][largest[0]][:, None], second[1][largest[1]][None])
    poses = [Pose.stack([])]
    for rotation in _rotations(a[:, :3], b[:, :3], area, is_upright=is_upright):
        alike = (a[:, :3] @ rotation @ b[:, :3].T > _LIKE_NORMALS) & (area > 2)
        shifts = _translations(a, b, alike, area, reach)
        poses.append(Pose(np.broadcast_to(rotation, (len(shifts), 3, 3)), shifts))
    return Pose.concatenate(poses)


def _rotations(a: Floats, b: Floats, area: Ints, *, is_upright: bool) -> list[Floats]:
    """Rotations from normals b (Q, 3) to normals a (P, 3), those that match most surface first."""
    frames_a, cosine_a = _frames(a, list(combinations(range(len(a)), 2)))
    frames_b, cosine_b = _frames(b, [(i, j) for i in range(len(b)) for j in range(len(b)) if i != j])
    if len(frames_a) == 0 or len(frames_b) == 0:
        return []
    off = np.arccos(cosine_a)[:, None] - np.arccos(cosine_b)[None]
    i, j = np.nonzero(np.abs(off) < _LIKE_ANGLES)
    if len(i) == 0:
        return []
    turns = np.einsum("kij,klj->kil", frames_a[i], frames_b[j])
    votes = np.zeros(len(turns))
    for start in range(0, len(turns), 4096):
        some = turns[start : start + 4096]
        alike = np.einsum("pi,kij,qj->kpq", a, some, b, optimize=True) > _LIKE_NORMALS
        votes[start : start + 4096] = np.sum(np.where(alike, np.sqrt(area), 0.0), axis=(1, 2))
    poses = Pose(turns, np.zeros((len(turns), 3)))
    worth, most = votes, _MOST_TILTED
    if is_upright:
        worth, most = votes * np.exp(-nats_of_tilt(poses) / 4), _MOST_ROTATIONS
    return [_fitted(turns[k], a, b, area) for k in _distinct(poses, worth, 1.0, most)]


def _frames(normals: Floats, pairs: list[tuple[int, int]]) -> tuple[Floats, Floats]:
    """Frames (K, 3, 3), columns, that pairs of normals span, and the cosines between them; parallel ones left out."""
    if not pairs:
        return np.zeros((0, 3, 3)), np.zeros(0)
    one, other = normals[np.array(pairs).T]
    cosine = np.clip(np.sum(one * other, axis=1), -1, 1)
    wide = np.sqrt(1 - cosine**2) > _LEAST_SINE
    one, other, cosine = one[wide], other[wide], cosine[wide]
    frames = np.stack([one + other, one - other, np.cross(one, other)], axis=-1)
    return frames / np.linalg.norm(frames, axis=1, keepdims=True), cosine


def _fitted(rotation: Floats, a: Floats, b: Floats, area: Ints) -> Floats:
    """The closest rotation that aligns matching normals, large planes first."""
    weight = np.where(a @ rotation @ b.T > _LIKE_NORMALS, np.sqrt(area), 0.0)
    return nearest_rotation(a.T @ weight @ b)


def _translations(a: Floats, b: Floats, alike: Bools, area: Ints, reach: float) -> Floats:
    """Translations (K, 3) that move planes b (Q, 4), already rotated, onto planes a (P, 4)."""
    p, q = np.nonzero(alike)
    order = np.argsort(-area[p, q], kind="stable")[:_MOST_PAIRS_OF_PLANES]
    p, q = p[order], q[order]
    normal, shift, weight = a[p, :3], a[p, 3] - b[q, 3], np.sqrt(area[p, q].astype(np.float64))
    translations = [_meeting(normal, shift, weight, reach), _along_lines(normal, shift, weight, reach)]
    return np.concatenate(translations)


def _meeting(normal: Floats, shift: Floats, weight: Floats, reach: float) -> Floats:
    """Where three planes normal · t = shift meet."""
    triples = np.array(list(combinations(range(len(normal)), 3)), np.int64).reshape(-1, 3)
    volume = np.abs(np.linalg.det(normal[triples])) if len(triples) else np.zeros(0)
    triples = triples[volume > _LEAST_SINE**2]
    triples = triples[np.argsort(-np.prod(weight[triples], axis=1), kind="stable")[:_MOST_TRIPLES]]
    if len(triples) == 0:
        return np.zeros((0, 3))
    met: Floats = np.linalg.solve(normal[triples], shift[triples][..., None])[..., 0]
    within: Floats = met[np.linalg.norm(met, axis=1) < reach]
    return within


def _along_lines(normal: Floats, shift: Floats, weight: Floats, reach: float) -> Floats:
    """Steps along the lines in which two of them meet."""
    pairs = np.array(list(combinations(range(len(normal)), 2)), np.int64).reshape(-1, 2)
    along = np.cross(normal[pairs[:, 0]], normal[pairs[:, 1]]) if len(pairs) else np.zeros((0, 3))
    length = np.linalg.norm(along, axis=1)
    good = length > _LEAST_SINE
    pairs, along = pairs[good], along[good] / length[good, None]
    chosen = np.argsort(-np.prod(weight[pairs], axis=1), kind="stable")[:_MOST_LINES]
    steps = np.linspace(-reach, reach, _LINE_STEPS)
    translations = [np.zeros((0, 3))]
    for k in chosen:
        foot = np.linalg.lstsq(normal[pairs[k]], shift[pairs[k]], rcond=None)[0]
        translations.append(foot + steps[:, None] * along[k])
    return np.concatenate(translations)


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


_VOXELS_ACROSS = 50
_RADIUS_VOXELS, _NEIGHBOURS = 5.0, 100
_APART_VOXELS, _LIKE_EDGES = 1.5, 0.9
_ITERATIONS, _CONFIDENCE = 50_000, 0.999
_SEEDS = (0, 1, 2)


def shape_poses(first: Surfaces, second: Surfaces) -> list[Pose]:
    """X_first = R X_second + t, as several runs suppose it. Raises ImportError where Open3D cannot be loaded."""
    o3d = open3d()
    voxel = max(_extent(first), _extent(second)) / _VOXELS_ACROSS
    clouds: list[Any] = []
    features: list[Any] = []
    for surfaces in (first, second):
        there = np.isfinite(surfaces.image.normals[..., 2])
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(surfaces.image.points[there]))
        cloud.normals = o3d.utility.Vector3dVector(surfaces.image.normals[there])
        cloud = cloud.voxel_down_sample(voxel)
        cloud.normalize_normals()
        around = o3d.geometry.KDTreeSearchParamHybrid(_RADIUS_VOXELS * voxel, _NEIGHBOURS)
        clouds.append(cloud)
        features.append(o3d.pipelines.registration.compute_fpfh_feature(cloud, around))
    if min(len(cloud.points) for cloud in clouds) < 3:
        return []
    return [_ransac(clouds, features, voxel, seed) for seed in _SEEDS]


def _ransac(clouds: list[Any], features: list[Any], voxel: float, seed: int) -> Pose:
    o3d = open3d()
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed)
    ransac = registration.registration_ransac_based_on_feature_matching(
        clouds[1],
        clouds[0],
        features[1],
        features[0],
        True,
        _APART_VOXELS * voxel,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(_LIKE_EDGES),
            registration.CorrespondenceCheckerBasedOnDistance(_APART_VOXELS * voxel),
        ],
        registration.RANSACConvergenceCriteria(_ITERATIONS, _CONFIDENCE),
    )
    pose: Floats = np.asarray(ransac.transformation, np.float64)
    return Pose(pose[:3, :3].copy(), pose[:3, 3].copy())


def _extent(surfaces: Surfaces) -> float:
    """How large the greater part of a station's surfaces is."""
    low, high = np.percentile(surfaces.patches.points, (5, 95), axis=0)
    return float(np.linalg.norm(high - low))
