"""How two devices stand to each other, and the steps by which that changes."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.arrays import Floats


@dataclass(frozen=True)
class Motion:
    """X_second = R X_first + t: `rotation` (3, 3), `translation` (3,) in baselines."""

    rotation: Floats
    translation: Floats

    @property
    def length(self) -> float:
        """Distance between the devices."""
        return float(np.linalg.norm(self.translation))

    def moved(self, step: Floats) -> "Motion":
        """After a step (5,) of rotation and direction, or (6,) of the length's logarithm as well."""
        direction = self.translation / self.length
        direction = direction + tangent_basis(direction) @ step[3:5]
        length = self.length * np.exp(step[5:].sum())
        return Motion(
            Rotation.from_rotvec(step[:3]).as_matrix() @ self.rotation,
            direction * (length / np.linalg.norm(direction)),
        )

    def step_to(self, other: "Motion") -> Floats:
        """The step (6,) to another motion not too far away."""
        ahead, there = self.translation / self.length, other.translation / other.length
        turn = Rotation.from_matrix(other.rotation @ self.rotation.T).as_rotvec()
        return np.concatenate([turn, tangent_basis(ahead).T @ (there - ahead), [np.log(other.length / self.length)]])


def tangent_basis(direction: Floats) -> Floats:
    """Two unit vectors (3, 2) perpendicular to a unit vector (3,)."""
    first = np.zeros(3)
    first[int(np.argmin(np.abs(direction)))] = 1.0
    first -= direction * (direction @ first)
    first /= np.sqrt(first @ first)
    return np.stack([first, cross(direction, first)], axis=1)


def cross(a: Floats, b: Floats) -> Floats:
    """a × b along the last axis, broadcast; several times faster than numpy's for short arrays."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
