"""The relative pose of two devices, and steps in its tangent space."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from calib.numerics import Floats, compiled

_TINY = 1e-8  # radians, below which the quotients of Rodrigues' formula are at their limits


@dataclass(frozen=True)
class Motion:
    """X_second = R X_first + t: `rotation` (3, 3), `translation` (3,) in baselines."""

    rotation: Floats
    translation: Floats

    @cached_property
    def length(self) -> float:
        """Distance between the devices."""
        return float(np.sqrt(self.translation @ self.translation))

    def moved(self, step: Floats) -> "Motion":
        """Return the motion after a step (5,) of rotation and direction, or (6,) including the log length."""
        length = self.length
        ahead = self.translation / length
        aside: Floats = ahead + tangent_basis(ahead) @ step[3:5]
        if len(step) > 5:
            length *= np.exp(step[5])
        return Motion(rotation_about(step[:3]) @ self.rotation, aside * (length / np.sqrt(aside @ aside)))

    def step_to(self, other: "Motion") -> Floats:
        """Return the step (6,) to a nearby motion."""
        ahead, there = self.translation / self.length, other.translation / other.length
        turn = Rotation.from_matrix(other.rotation @ self.rotation.T).as_rotvec()
        return np.concatenate([turn, tangent_basis(ahead).T @ (there - ahead), [np.log(other.length / self.length)]])


STILL = Motion(np.eye(3), np.zeros(3))


def nearest_rotation(matrix: Floats) -> Floats:
    """The rotations (..., 3, 3) nearest to matrices (..., 3, 3).

    Of Σ a bᵀ it is the one that turns the vectors b nearest to those a (Kabsch, "A solution for the best rotation to
    relate two sets of vectors", 1976).
    """
    u, _, vt = np.linalg.svd(matrix)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return np.asarray(u @ vt)


def angle_between(rotations: Floats, other: Floats) -> Floats:
    """How far rotations (..., 3, 3) are from another one (3, 3), in radians, (...,)."""
    cosine = (np.einsum("...ij,ij->...", rotations, other) - 1) / 2
    angle: Floats = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angle


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


def cross(a: Floats, b: Floats) -> Floats:
    """a × b along the last axis, broadcast; several times faster than numpy's for short arrays."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
