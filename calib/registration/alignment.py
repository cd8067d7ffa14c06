"""Point-to-plane registration by projection: each patch is compared with the surface in the same direction of the other
camera.

Chen and Medioni, "Object modelling by registration of multiple range images", 1992; the closest point is searched along
the other camera's ray (Blais and Levine 1995), without a search tree. Matching keypoints of the pictures are included.
Poses move by twists of the room's frame: a rotation ω and a translation v take X to X + ω × X + v.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.geometry import Pose, cross_matrix
from calib.numerics import Floats, compiled
from calib.registration.agreement import FINE
from calib.registration.keypoints import match_keypoints
from calib.registration.range_view import Surfaces, pixel_under, rotate_vector

_LIKE = float(np.cos(np.radians(35.0)))
# Undetermined directions of a station do not move: damping relative to the determined ones.
_DAMPING = 1e-3
_STEPS = 12
_CONVERGED = 1e-6


@dataclass(frozen=True)
class NormalEquations:
    """Of the twist of one station against another: `matrix` (6, 6), `gradient` (6,), sums over `count` patches of
    squared relative distances, whose weighted sum is `square`; `weight` is the sum of the weights. Of keypoints there
    is something in the first two only.
    """

    matrix: Floats
    gradient: Floats
    square: float
    weight: float
    count: int


def normal_equations(
    moving: Surfaces,
    place: Pose,
    still: Surfaces,
    still_place: Pose,
    tolerance: float,
    patches: int | None = None,
) -> NormalEquations:
    """Normal equations for the twist of `moving`, from the patches of both; for `still`, the gradient changes its sign.

    `tolerance`: relative to the depth, beyond the noise.
    """
    sums, scalars = np.zeros((6, 7)), np.zeros(3)
    for one, at, other, other_at, sign in (
        (moving, place, still, still_place, 1.0),
        (still, still_place, moving, place, -1.0),
    ):
        part = np.zeros((6, 7))
        _add_up(
            one.patches[:patches],
            one.patch_normals[:patches],
            np.ascontiguousarray(at.rotation),
            at.translation,
            other.points,
            other.normals,
            other.lens,
            np.ascontiguousarray(other_at.rotation),
            other_at.translation,
            tolerance,
            3 * (one.noise + other.noise),
            part,
            scalars,
        )
        part[:, 6] *= sign
        sums += part
    sums += _of_keypoints(moving, place, still, still_place, tolerance)
    return NormalEquations(sums[:, :6], sums[:, 6], float(scalars[0]), float(scalars[1]), int(scalars[2]))


def _of_keypoints(moving: Surfaces, place: Pose, still: Surfaces, still_place: Pose, tolerance: float) -> Floats:
    """Normal matrix and gradient (6, 7) of matching keypoints that should coincide, with Tukey's weights."""
    own, matching = match_keypoints(moving.keypoints, still.keypoints)
    points = place @ moving.keypoints.points[own]
    off = points - still_place @ still.keypoints.points[matching]
    depth = moving.keypoints.points[own, 2]
    relative = np.linalg.norm(off, axis=1) / (tolerance * depth)
    near = relative < 1
    if not near.any():
        return np.zeros((6, 7))
    points, off = points[near], off[near]
    weight = ((1 - relative[near] ** 2) / depth[near]) ** 2
    by_twist = np.concatenate([cross_matrix(points), np.broadcast_to(np.eye(3), (len(off), 3, 3))], 1)
    sums = np.empty((6, 7))
    sums[:, :6] = np.einsum("n,nia,nja->ij", weight, by_twist, by_twist)
    sums[:, 6] = np.einsum("n,nia,na->i", weight, by_twist, off)
    return sums


def align(
    moving: Surfaces,
    place: Pose,
    fixed: Sequence[tuple[Surfaces, Pose]],
    tolerances: Sequence[float],
    patches: int | None = None,
) -> Pose:
    """The pose of one station that best fits the others, which are fixed, with one tolerance after the other."""
    for tolerance in tolerances:
        for _ in range(_STEPS):
            matrix, gradient = np.zeros((6, 6)), np.zeros(6)
            for still, still_place in fixed:
                equations = normal_equations(moving, place, still, still_place, tolerance, patches)
                matrix += equations.matrix
                gradient += equations.gradient
            twist = _step(matrix, gradient, place.translation)
            place = Pose.from_vector(twist) @ place
            if np.abs(twist).max() < _CONVERGED * max(1.0, moving.distance):
                break
    return place


def align_jointly(stations: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> dict[int, Pose]:
    """All places at once; the first station's stays."""
    now = dict(places)
    names = list(now)
    pairs = list(combinations(names, 2))
    for _ in range(_STEPS):
        equations = {(a, b): normal_equations(stations[a], now[a], stations[b], now[b], FINE) for a, b in pairs}
        pairs = [pair for pair in pairs if equations[pair].count > 0]
        between = [(names.index(a), names.index(b), equations[a, b].matrix, equations[a, b].gradient) for a, b in pairs]
        matrix, gradient = couple_poses(between, len(names))
        damping = _DAMPING * np.diag(matrix)[6:] + 1e-12
        twists = -np.linalg.solve(matrix[6:, 6:] + np.diag(damping), gradient[6:]).reshape(-1, 6).astype(np.float64)
        for name, twist in zip(names[1:], twists, strict=True):
            now[name] = Pose.from_vector(twist) @ now[name]
        if np.abs(twists).max(initial=0.0) < _CONVERGED * stations[names[0]].distance:
            break
    return now


def couple_poses(between: Iterable[tuple[int, int, Floats, Floats]], count: int) -> tuple[Floats, Floats]:
    """Matrix (6 n, 6 n) and gradient (6 n,) of the twists of all places, from those by the first twist of each pair,
    whose numbers come before them; the second one has the opposite effect.
    """
    matrix, gradient = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
    for first, second, own, pull in between:
        i, j = slice(6 * first, 6 * first + 6), slice(6 * second, 6 * second + 6)
        matrix[i, i] += own
        matrix[j, j] += own
        matrix[i, j] -= own
        matrix[j, i] -= own
        gradient[i] += pull
        gradient[j] -= pull
    return matrix, gradient


def _step(matrix: Floats, gradient: Floats, centre: Floats) -> Floats:
    """The damped Gauss–Newton twist; damping applies to rotations about a centre (3,) and translations."""
    if not matrix.any():
        return np.zeros(6)
    about = np.eye(6)  # twist about the centre → twist of the frame
    about[3:, :3] = -np.cross(np.eye(3), centre)
    own = about.T @ matrix @ about
    turns, shifts = np.trace(own[:3, :3]) / 3, np.trace(own[3:, 3:]) / 3
    damped = own + _DAMPING * np.diag([turns] * 3 + [shifts] * 3) + 1e-12 * np.eye(6)
    return about @ -np.linalg.solve(damped, about.T @ gradient)


@compiled
def _add_up(
    patches: Floats,
    patch_normals: Floats,
    rotation: Floats,
    translation: Floats,
    points: Floats,
    normals: Floats,
    lens: Floats,
    camera_rotation: Floats,
    camera_translation: Floats,
    tolerance: float,
    noise: float,
    sums: Floats,
    scalars: Floats,
) -> None:
    """Add to `sums` (6, 7), the normal matrix and the gradient by the patches' twist, with Tukey's weights; and to
    `scalars` (3,): squares, weights, number.
    """
    height, width = points.shape[:2]
    r = camera_rotation.T @ rotation
    t = camera_rotation.T @ (translation - camera_translation)
    j6 = np.empty(6)
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
        if not (np.abs(off) < within and np.abs(z - depth) < 6 * within):
            continue
        e0, e1, e2 = rotate_vector(r, patch_normals[m])
        like = p * e0 + q * e1 + s * e2
        if not like > _LIKE:
            continue
        # In the room's frame, where the patch is and where the normal points.
        e = camera_rotation
        u = e[0, 0] * x + e[0, 1] * y + e[0, 2] * z + camera_translation[0]
        v = e[1, 0] * x + e[1, 1] * y + e[1, 2] * z + camera_translation[1]
        w = e[2, 0] * x + e[2, 1] * y + e[2, 2] * z + camera_translation[2]
        j6[3] = e[0, 0] * p + e[0, 1] * q + e[0, 2] * s
        j6[4] = e[1, 0] * p + e[1, 1] * q + e[1, 2] * s
        j6[5] = e[2, 0] * p + e[2, 1] * q + e[2, 2] * s
        j6[0] = v * j6[5] - w * j6[4]
        j6[1] = w * j6[3] - u * j6[5]
        j6[2] = u * j6[4] - v * j6[3]
        weight = (1 - (off / within) ** 2) ** 2 / (depth * depth)
        for k in range(6):
            for n in range(6):
                sums[k, n] += weight * j6[k] * j6[n]
            sums[k, 6] += weight * off * j6[k]
        scalars[0] += weight * off * off
        scalars[1] += (1 - (off / within) ** 2) ** 2
        scalars[2] += 1
