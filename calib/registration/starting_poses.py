"""Poses to begin with: rotations that cover all directions and turns evenly, poses that bring planes onto planes, and
what is distinct of many poses.

Two pairs of planes that enclose like angles give a rotation; in a room there are few, for most planes are square to
each other. Given the rotation, each pair of planes with like normals fixes the translation along its normal: three of
them fix it, two leave it open along a line, which is then searched in steps.
"""

from itertools import combinations

import numpy as np
import scipy

from calib.geometry import Pose, nearest_rotation
from calib.numerics import Bools, Floats, Ints, distinct
from calib.registration.agreement import nats_of_tilt

# Radicals of super-Fibonacci spirals: φ² = 2, ψ⁴ = ψ + 4.
_PHI, _PSI = 2**0.5, 1.533751168755204288118041


def even_rotations(count: int) -> Floats:
    """Rotations (count, 3, 3): any rotation is about 180° / ∛count from the nearest.

    Alexa, "Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3)", 2022.
    """
    s = np.arange(count) + 0.5
    near, far = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / _PHI, 2 * np.pi * s / _PSI
    quaternions = near * np.sin(alpha), near * np.cos(alpha), far * np.sin(beta), far * np.cos(beta)
    return scipy.spatial.transform.Rotation.from_quat(np.stack(quaternions, axis=1)).as_matrix()


def distinct_poses(poses: Pose, worth: Floats, turn: float, shift: float, most: int) -> list[int]:
    """Numbers of the best of K poses by their `worth` (K,), each by a `turn` in radians or a `shift` away from better
    ones.
    """
    order = np.argsort(-worth, kind="stable")
    ordered = poses[order]
    return [int(order[k]) for k in distinct(len(order), lambda k: ordered.is_near(ordered[k], turn, shift), most)]


_MOST_PLANES = 14
_LIKE_ANGLES = np.radians(4.0)
_LIKE_NORMALS = float(np.cos(np.radians(6.0)))
LEAST_SINE = 0.4
_SAME_ROTATION = np.radians(5.0)
_MOST_ROTATIONS, _MOST_PAIRS_OF_PLANES, _MOST_TRIPLES, _MOST_LINES, _LINE_STEPS = 16, 40, 1500, 12, 100
_MOST_TILTED = 24  # rotations of a cube onto itself


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
    return [_fitted(turns[k], a, b, area) for k in distinct_poses(poses, worth, _SAME_ROTATION, 1.0, most)]


def _frames(normals: Floats, pairs: list[tuple[int, int]]) -> tuple[Floats, Floats]:
    """Frames (K, 3, 3), columns, that pairs of normals span, and the cosines between them; parallel ones left out."""
    if not pairs:
        return np.zeros((0, 3, 3)), np.zeros(0)
    one, other = normals[np.array(pairs).T]
    cosine = np.clip(np.sum(one * other, axis=1), -1, 1)
    wide = np.sqrt(1 - cosine**2) > LEAST_SINE
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
    triples = triples[volume > LEAST_SINE**2]
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
    good = length > LEAST_SINE
    pairs, along = pairs[good], along[good] / length[good, None]
    chosen = np.argsort(-np.prod(weight[pairs], axis=1), kind="stable")[:_MOST_LINES]
    steps = np.linspace(-reach, reach, _LINE_STEPS)
    translations = [np.zeros((0, 3))]
    for k in chosen:
        foot = np.linalg.lstsq(normal[pairs[k]], shift[pairs[k]], rcond=None)[0]
        translations.append(foot + steps[:, None] * along[k])
    return np.concatenate(translations)
