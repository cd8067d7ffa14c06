"""Poses: rigid motions of space, SE(3), alone or in batches; rotations and their vectors; steps of estimators.

A vector of six is a rotation vector (radians), then a translation. Formulas of exp, log and adjoint are Barfoot's,
"State estimation for robotics", section 7.1, whose vectors have the translation first.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, overload

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Ints, compiled

_Points = NDArray[np.floating[Any]]

PER_POSE = 6  # numbers of a step: a rotation vector and a translation
_TINY = 1e-8  # radians, below which the quotients of Rodrigues' formula are at their limits
_SMALL = 0.03  # radians, below which (θ − sin θ) / θ³ loses more digits than its series


@dataclass(frozen=True, eq=False)
class Pose:
    """The rigid motion X → R X + t, from the frame of what is posed to the frame that it is posed in.

    A camera's pose in a room leads from the camera's frame to the room's; a rig's pose leads from its camera's frame to
    its projector's. `pose @ points` moves points, and `second @ first` is first one motion, then the other.
    """

    rotation: Floats
    """R, (..., 3, 3)."""
    translation: Floats
    """t, (..., 3): where the origin goes."""

    @classmethod
    def from_vector(cls, vector: Floats) -> "Pose":
        """The pose of a rotation vector and a translation, (6,)."""
        return cls(rotation_about(vector[:3]), vector[3:])

    @classmethod
    def exp(cls, twist: Floats) -> "Pose":
        """The motions after unit time at constant velocity, for twists (..., 6): angular and linear velocity."""
        angular, linear = twist[..., :3], twist[..., 3:]
        return cls(rotations_about(angular), (left_jacobian(angular) @ linear[..., None])[..., 0])

    def log(self) -> Floats:
        """The twists (..., 6) whose `exp` these poses are, with angles up to π."""
        angular = rotation_vector(self.rotation)
        linear = np.linalg.solve(left_jacobian(angular), self.translation[..., None])[..., 0]
        return np.concatenate([angular, linear], axis=-1)

    @classmethod
    def stack(cls, poses: "Sequence[Pose]") -> "Pose":
        """A batch (K,) of single poses."""
        rotations = [pose.rotation for pose in poses]
        return cls(np.reshape(rotations, (-1, 3, 3)), np.reshape([pose.translation for pose in poses], (-1, 3)))

    @classmethod
    def concatenate(cls, batches: "Sequence[Pose]") -> "Pose":
        """One batch of several."""
        rotations = [batch.rotation for batch in batches]
        return cls(np.concatenate(rotations), np.concatenate([batch.translation for batch in batches]))

    def __getitem__(self, chosen: "int | np.integer[Any] | slice | Bools | Ints | list[int] | None") -> "Pose":
        """One of a batch, or some of them; a batch of one with None."""
        return Pose(self.rotation[chosen], self.translation[chosen])

    @overload
    def __matmul__(self, operand: "Pose") -> "Pose": ...

    @overload
    def __matmul__(self, operand: _Points) -> Floats: ...

    def __matmul__(self, operand: "Pose | _Points") -> "Pose | Floats":
        """Compose with the pose that comes before, or move points (..., 3). Each pose of a batch (..., 3, 3) moves all
        points (..., N, 3): the axes before the last two are broadcast.
        """
        if isinstance(operand, Pose):
            moved = (self.rotation @ operand.translation[..., None])[..., 0] + self.translation
            return Pose(self.rotation @ operand.rotation, moved)
        points: Floats = self.rotate(operand)
        points += self.translation if self.translation.ndim == 1 else self.translation[..., None, :]
        return points

    def rotate(self, directions: _Points) -> Floats:
        """Directions (..., 3) after the motion, broadcast as points are."""
        return directions @ np.swapaxes(self.rotation, -1, -2)

    def undo(self, points: _Points) -> Floats:
        """Where points (..., 3) were before the motion of a single pose, without the rounding of `inverse` far away."""
        return (points - self.translation) @ self.rotation

    def inverse(self) -> "Pose":
        """The way back."""
        back = np.swapaxes(self.rotation, -1, -2)
        return Pose(back, -(back @ self.translation[..., None])[..., 0])

    @property
    def adjoint(self) -> Floats:
        """The matrices (..., 6, 6) that take twists of the posed frame to those of the frame that it is posed in."""
        adjoint = np.zeros((*self.translation.shape[:-1], 6, 6))
        adjoint[..., :3, :3] = adjoint[..., 3:, 3:] = self.rotation
        adjoint[..., 3:, :3] = cross_matrix(self.translation) @ self.rotation
        return adjoint

    @cached_property
    def distance(self) -> float:
        """Distance between the origins of both frames, of a single pose."""
        return float(np.sqrt(self.translation @ self.translation))

    @property
    def matrix(self) -> Floats:
        """[R, t; 0, 1], (..., 4, 4)."""
        matrix = np.zeros((*self.translation.shape[:-1], 4, 4))
        matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = self.rotation, self.translation, 1.0
        return matrix

    @property
    def angle(self) -> Floats:
        """By how much the motion turns, in radians, (...,)."""
        angle: Floats = np.linalg.norm(rotation_vector(self.rotation), axis=-1)
        return angle

    def angle_from(self, reference: "Pose") -> Floats:
        """By how much poses are turned against a reference, in radians, (...,); rounded to 1e-8, but fast."""
        cosine = (np.einsum("...ij,ij->...", self.rotation, reference.rotation) - 1) / 2
        angle: Floats = np.arccos(np.clip(cosine, -1.0, 1.0))
        return angle

    def is_near(self, reference: "Pose", turn: float, apart: float) -> Bools:
        """Which poses are turned by less than `turn` in radians, and moved by less than `apart`, from a reference."""
        near: Bools = np.linalg.norm(self.translation - reference.translation, axis=-1) < apart
        return near & (self.angle_from(reference) < turn)

    def scaled(self, factor: float) -> "Pose":
        """The same with lengths multiplied by a factor, as in another unit."""
        return Pose(self.rotation, factor * self.translation)

    @property
    def in_baselines(self) -> "Pose":
        """The same with its own `distance` as the unit of length."""
        return Pose(self.rotation, self.translation / self.distance)

    def retract(self, step: Floats, unit: float = 1.0) -> "Pose":
        """The pose after a step (6,): a rotation of the posed frame about its origin, by a vector in the axes of the
        frame that it is posed in, and a translation there in this `unit`.
        """
        return Pose(rotation_about(step[:3]) @ self.rotation, self.translation + unit * step[3:])

    def local(self, target: "Pose", unit: float = 1.0) -> Floats:
        """The step (6,) whose `retract` is a nearby pose."""
        turn = rotation_vector(target.rotation @ self.rotation.T)
        return np.concatenate([turn, (target.translation - self.translation) / unit])

    def retract_baseline(self, step: Floats) -> "Pose":
        """The pose after a step of its rotation (3), the direction of its translation (2) along `tangent_basis`, and
        the logarithm of its distance, which may be left out, as of a pose without a scale.
        """
        distance, ahead = self.distance, self.translation / self.distance
        aside: Floats = ahead + tangent_basis(ahead) @ step[3:5]
        if len(step) > 5:
            distance *= np.exp(step[5])
        return Pose(rotation_about(step[:3]) @ self.rotation, aside * (distance / np.sqrt(aside @ aside)))

    def local_baseline(self, target: "Pose") -> Floats:
        """The step (6,) whose `retract_baseline` is a nearby pose."""
        ahead = self.translation / self.distance
        aside = tangent_basis(ahead).T @ (target.translation / target.distance - ahead)
        turn = rotation_vector(target.rotation @ self.rotation.T)
        return np.concatenate([turn, aside, [np.log(target.distance / self.distance)]])

    @property
    def by_direction(self) -> Floats:
        """Derivatives (3, 2) of the translation by its direction; those by the logarithm of its length are itself."""
        return self.distance * tangent_basis(self.translation / self.distance)


IDENTITY = Pose(np.eye(3), np.zeros(3))


def nearest_rotation(matrix: Floats) -> Floats:
    """The rotations (..., 3, 3) nearest to matrices (..., 3, 3).

    Of Σ a bᵀ it is the one that turns the vectors b nearest to those a (Kabsch, "A solution for the best rotation to
    relate two sets of vectors", 1976).
    """
    u, _, vt = np.linalg.svd(matrix)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return np.asarray(u @ vt)


def rotation_vector(rotations: Floats) -> Floats:
    """The axes of rotations (..., 3, 3), as long as their angles up to π in radians, (..., 3)."""
    vectors: Floats = scipy.spatial.transform.Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_rotvec()
    return vectors.reshape(rotations.shape[:-1])


def rotations_about(vectors: Floats) -> Floats:
    """The rotations (..., 3, 3) about vectors (..., 3) by their lengths in radians."""
    rotations = np.empty((*vectors.shape, 3))
    _rotate_about(np.ascontiguousarray(vectors, np.float64).reshape(-1, 3), rotations.reshape(-1, 3, 3))
    return rotations


def left_jacobian(vectors: Floats) -> Floats:
    """Derivatives (..., 3, 3) of the translation of `Pose.exp` by its linear velocity, for rotation vectors (..., 3).

    I + (1 − cos θ) / θ² [ω]× + (θ − sin θ) / θ³ [ω]×², with θ = |ω|.
    """
    turn = cross_matrix(vectors)
    square = np.sum(vectors**2, axis=-1)[..., None, None]
    angle = np.sqrt(square)
    large = np.where(angle > _SMALL, angle, 1.0)
    by_turn = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    series = 1 / 6 - square / 120 + square**2 / 5040
    by_square = np.where(angle > _SMALL, (large - np.sin(large)) / large**3, series)
    jacobian: Floats = np.eye(3) + by_turn * turn + by_square * (turn @ turn)
    return jacobian


def cross_matrix(vectors: Floats) -> Floats:
    """[v]× of vectors (..., 3), (..., 3, 3): its product with a vector is v × vector."""
    matrix = np.zeros((*vectors.shape, 3))
    for k in range(3):
        matrix[..., (k + 2) % 3, (k + 1) % 3] = vectors[..., k]
        matrix[..., (k + 1) % 3, (k + 2) % 3] = -vectors[..., k]
    return matrix


@compiled
def rotation_about(vector: Floats) -> Floats:
    """The rotation (3, 3) about a vector (3,) by its length in radians.

    Rodrigues' formula: I + a [ω]× + b (ω ωᵀ − |ω|² I) with a = sin |ω| / |ω| and b = (1 − cos |ω|) / |ω|².
    """
    x, y, z = vector
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    a, b = (np.sin(angle) / angle, 2 * np.sin(angle / 2) ** 2 / square) if angle > _TINY else (1.0, 0.5)
    return np.array(
        [
            [1 + b * (x * x - square), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1 + b * (y * y - square), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1 + b * (z * z - square)],
        ]
    )


@compiled
def _rotate_about(vectors: Floats, rotations: Floats) -> None:
    """Fill in `rotations` (N, 3, 3) about vectors (N, 3)."""
    for i in range(len(vectors)):
        rotations[i] = rotation_about(vectors[i])


@compiled
def tangent_basis(direction: Floats) -> Floats:
    """Two unit vectors (3, 2) perpendicular to a unit vector (3,)."""
    smallest = np.argmin(np.abs(direction))
    length = np.sqrt(1 - direction[smallest] ** 2)
    basis = np.empty((3, 2))
    for k in range(3):
        basis[k, 0] = ((k == smallest) - direction[smallest] * direction[k]) / length
    for k in range(3):
        second, third = (k + 1) % 3, (k + 2) % 3
        basis[k, 1] = direction[second] * basis[third, 0] - direction[third] * basis[second, 0]
    return basis


@compiled
def dot(a: Floats, b: Floats) -> float:
    """a · b of two vectors (3,), for compiled functions."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def cross(a: Floats, b: Floats) -> Floats:
    """a × b along the last axis, broadcast; several times faster than numpy's for short arrays."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
