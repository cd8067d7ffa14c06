"""Patches of one view in another view's camera: the surface in their direction, what it says of them, and the step of
the pose that lays them on it.

Point to plane, along the camera's ray instead of to the closest point (Chen and Medioni, "Object modelling by
registration of multiple range images", 1992; Blais and Levine, "Registering multiview range data to create 3D computer
objects", 1995). Rooms and things differ in the gates alone; descents differ in what they pair, not in their steps.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose, rotation_about
from calib.numerics import Floats, Ints, compiled, inlined


@inlined
def add_pair(
    matrix: Floats,
    gradient: Floats,
    arm: tuple[float, float, float],
    normal: tuple[float, float, float],
    off: float,
    weight: float,
) -> None:
    """Add a pair to normal equations (6, 6), (6,) of a rotation about a centre, and a shift.

    `arm`: from the centre to the point; `off`: its distance from the plane, along the `normal`.
    """
    u, v, w = arm
    p, q, s = np.float64(normal[0]), np.float64(normal[1]), np.float64(normal[2])
    row = v * s - w * q, w * p - u * s, u * q - v * p, p, q, s
    for i in range(6):
        for j in range(6):
            matrix[i, j] += weight * row[i] * row[j]
        gradient[i] += weight * off * row[i]


@compiled
def step_pose(
    matrix: Floats, gradient: Floats, damping: float, centre: Floats, rotation: Floats, translation: Floats
) -> float:
    """Solve the normal equations, in place, and move a pose (3, 3), (3,), in place. Returns the largest number of the
    twist about the centre (3,); 0 where nothing holds the pose.

    `damping`: relative to the trace of rotations, and to that of shifts.
    """
    trace_turn = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    trace_shift = matrix[3, 3] + matrix[4, 4] + matrix[5, 5]
    if not trace_turn * trace_shift > 0:
        return 0.0
    for i in range(3):
        matrix[i, i] += damping * trace_turn
        matrix[i + 3, i + 3] += damping * trace_shift
    twist: Floats = -np.linalg.solve(matrix, gradient).astype(np.float64)
    turn = rotation_about(twist[:3])
    rotation[:] = turn @ rotation
    translation[:] = turn @ (translation - centre) + centre + twist[3:]
    return float(np.abs(twist).max())


UNSEEN, HIDDEN, THROUGH_FREE_SPACE, OFF_SURFACE = -1, -2, -3, -4
_TOWARDS_MIDDLE = 0.1  # share of a patch's weight by which a centre is drawn to a point behind the visible surface
_DAMPING = 1e-3  # of a descent's step, relative to what holds the pose


class RangeImage(NamedTuple):
    """What a camera measured, on its grid of pixels."""

    points: NDArray[np.floating]
    """(H, W, 3), in the camera's frame; NaN where there is no surface to compare with."""
    normals: NDArray[np.floating]
    """(H, W, 3), towards the camera."""
    depth: NDArray[np.floating]
    """(H, W): how far the camera saw at all; 0 or NaN where nothing is known."""
    near: NDArray[np.floating]
    """(H, W): the least depth around each pixel."""
    lens: Floats
    """(9,): focal lengths, principal point, distortion as of `Intrinsics`."""


class Patches(NamedTuple):
    """Points of a surface."""

    points: Floats
    """(M, 3)"""
    normals: Floats
    """(M, 3)"""

    def first(self, count: int | None) -> "Patches":
        """So many of them; all for None."""
        return Patches(self.points[:count], self.normals[:count])

    def normal_centre(self, behind: float) -> Floats:
        """The point (3,) that the lines along all normals come closest to: the middle, if the surface is round. It is
        drawn a little to a point `behind` the surface.
        """
        across = np.eye(3) - self.normals[:, :, None] * self.normals[:, None]
        middle = self.points.mean(axis=0)
        anchor = middle * (1 + behind / max(float(np.linalg.norm(middle)), 1e-300))
        drawn = _TOWARDS_MIDDLE * len(across)
        pull = np.einsum("nij,nj->i", across, self.points) + drawn * anchor
        return np.linalg.solve(across.sum(axis=0) + drawn * np.eye(3), pull)


class Gates(NamedTuple):
    """When a patch meets a surface, and when it contradicts one. Lengths are in the points' unit, or in depths."""

    is_relative: bool
    """Whether lengths are in depths; residuals are then weighted so, too."""
    along_ray: float
    """Largest distance from a surface along the ray, in largest distances along its normal."""
    like: float
    """Least cosine of both normals."""
    beyond: float
    """How many such distances a patch must be in front of all around it, to be where the camera looked through."""
    free: float
    """How much farther in front of it."""
    off: float
    """Distance along the ray up to which a patch that does not meet the surface is off it, whatever else is there."""
    shows_backs: bool
    """Whether patches that face away from the camera count."""


@compiled
def rotate_vector(r: Floats, vector: Floats) -> tuple[float, float, float]:
    """R (3, 3) times a vector (3,), without an array for the result."""
    a, b, c = vector[0], vector[1], vector[2]
    return (
        r[0, 0] * a + r[0, 1] * b + r[0, 2] * c,
        r[1, 0] * a + r[1, 1] * b + r[1, 2] * c,
        r[2, 0] * a + r[2, 1] * b + r[2, 2] * c,
    )


@compiled
def pixel_under(x: float, y: float, z: float, lens: Floats, height: int, width: int) -> tuple[int, int]:
    """Row and column that a point in the camera's frame falls on; (−1, −1) outside the picture or behind the camera."""
    if not z > 1e-9:
        return -1, -1
    u, v = x / z, y / z
    q = u * u + v * v
    radial = 1 + q * (lens[4] + q * (lens[5] + q * lens[8]))
    across = u * radial + 2 * lens[6] * u * v + lens[7] * (q + 2 * u * u)
    down = v * radial + lens[6] * (q + 2 * v * v) + 2 * lens[7] * u * v
    column, row = np.floor(lens[0] * across + lens[2] + 0.5), np.floor(lens[1] * down + lens[3] + 0.5)
    if not (0 <= column < width and 0 <= row < height):
        return -1, -1
    return int(row), int(column)


def classify(image: RangeImage, patches: Patches, poses: Pose, gates: Gates, within: float, noise: float = 0.0) -> Ints:
    """For K poses X_camera = R X + t and each patch the flat index of the pixel whose surface it meets, or the reason
    why there is none, (K, M).

    `within`: largest distance from the surface along its normal; `noise`: what is added to it per depth squared, where
    lengths are in depths.
    """
    fates = np.empty((len(poses.translation), len(patches.points)), np.int64)
    turns, shifts = np.ascontiguousarray(poses.rotation), np.ascontiguousarray(poses.translation)
    _classify(image, patches, turns, shifts, gates, within, noise, fates)
    return fates


def descend(
    image: RangeImage, patches: Patches, poses: Pose, gates: Gates, withins: Floats, centre: Floats
) -> tuple[Pose, Floats]:
    """Poses (K,) after a point-to-plane step for each of the distances `withins`, with rotations about a centre (3,).

    With them how much met before the last step, less what was where the camera looked through, in patches, (K,).
    """
    moved, worth = Pose(poses.rotation.copy(), poses.translation.copy()), np.zeros(len(poses.translation))
    _descend(image, patches, moved.rotation, moved.translation, gates, withins, centre, worth)
    return moved, worth


@compiled
def _classify(
    image: RangeImage,
    patches: Patches,
    turns: Floats,
    shifts: Floats,
    gates: Gates,
    within: float,
    noise: float,
    fates: Ints,
) -> None:
    places, towards = patches
    points, normals, depths, near, lens = image
    height, width = depths.shape
    for k in range(len(turns)):
        r, t = turns[k], shifts[k]
        for m in range(len(places)):
            fates[k, m] = UNSEEN
            x, y, z = rotate_vector(r, places[m])
            x, y, z = x + t[0], y + t[1], z + t[2]
            i, j = pixel_under(x, y, z, lens, height, width)
            if i < 0:
                continue
            e, f, g = rotate_vector(r, towards[m])
            if not gates.shows_backs and e * x + f * y + g * z >= 0:
                continue
            depth = np.float64(depths[i, j])
            unit = depth if gates.is_relative else 1.0
            most = unit * (within + noise * unit)
            if points[i, j, 2] > 0:
                p, q, s = normals[i, j, 0], normals[i, j, 1], normals[i, j, 2]
                ahead = z - points[i, j, 2]
                off = p * (x - points[i, j, 0]) + q * (y - points[i, j, 1]) + s * ahead
                if np.abs(off) < most and np.abs(ahead) < gates.along_ray * most:
                    fates[k, m] = i * width + j if p * e + q * f + s * g > gates.like else OFF_SURFACE
                    continue
                if np.abs(ahead) < gates.off * unit:
                    fates[k, m] = OFF_SURFACE
                    continue
            if depth > 0:
                if z < near[i, j] - gates.beyond * most - gates.free * unit:
                    fates[k, m] = THROUGH_FREE_SPACE
                elif z > depth:
                    fates[k, m] = HIDDEN


@compiled
def add_patches(
    image: RangeImage,
    patches: Patches,
    r: Floats,
    t: Floats,
    gates: Gates,
    within: float,
    noise: float,
    turn: Floats,
    shift: Floats,
    matrix: Floats,
    gradient: Floats,
) -> tuple[float, float, float, int]:
    """Add to the normal equations (6, 6), (6,) of a rotation and a shift, with Tukey's weights, in a frame to which a
    `turn` (3, 3) and a `shift` (3,) lead from the camera's.

    Returns how much meets, less what is where the camera looked through, in patches; the weighted sum of squared
    distances, in depths if the gates are; the sum of the weights; and how many patches met.
    """
    worth, square, weights, count = 0.0, 0.0, 0.0, 0
    places = patches.points
    points, normals = image.points.reshape(-1, 3), image.normals.reshape(-1, 3)
    fates = np.empty((1, len(places)), np.int64)
    _classify(image, patches, r.reshape(1, 3, 3), t.reshape(1, 3), gates, within, noise, fates)
    for m in range(len(places)):
        pixel = fates[0, m]
        if pixel == THROUGH_FREE_SPACE:
            worth -= 1.0
        if pixel < 0:
            continue
        x, y, z = rotate_vector(r, places[m])
        x, y, z = x + t[0], y + t[1], z + t[2]
        p, q, s = normals[pixel, 0], normals[pixel, 1], normals[pixel, 2]
        off = p * (x - points[pixel, 0]) + q * (y - points[pixel, 1]) + s * (z - points[pixel, 2])
        unit = points[pixel, 2] if gates.is_relative else 1.0
        share = 1 - (off / (unit * (within + noise * unit))) ** 2
        weight = share * share
        worth, weights, count = worth + share, weights + weight, count + 1
        weight /= unit * unit
        square += weight * off * off
        arm = (
            turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0],
            turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1],
            turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2],
        )
        add_pair(matrix, gradient, arm, rotate_vector(turn, normals[pixel]), off, weight)
    return worth, square, weights, count


@compiled
def _descend(
    image: RangeImage,
    patches: Patches,
    turns: Floats,
    shifts: Floats,
    gates: Gates,
    withins: Floats,
    centre: Floats,
    worth: Floats,
) -> None:
    as_is, back = np.eye(3), -centre
    for k in range(len(turns)):
        r, t = turns[k], shifts[k]
        for within in withins:
            matrix, gradient = np.zeros((6, 6)), np.zeros(6)
            worth[k] = add_patches(image, patches, r, t, gates, within, 0.0, as_is, back, matrix, gradient)[0]
            if step_pose(matrix, gradient, _DAMPING, centre, r, t) == 0:
                break
