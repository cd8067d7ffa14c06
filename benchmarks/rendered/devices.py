"""A camera and a projector with lenses, fixed to each other, and their poses."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
_CAMERA, _PROJECTOR = (640, 512), (854, 480)


@dataclass(frozen=True)
class Device:
    """A pinhole with distortion: width, height; f, x_0, y_0; k1, k2, p1, p2, k3 in OpenCV's order."""

    size: tuple[int, int]
    focal: float
    centre: tuple[float, float]
    lens: tuple[float, float, float, float, float]

    def project(self, points: Array) -> Array:
        zero = np.zeros(3)
        pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), zero, zero, self.matrix, np.array(self.lens))
        return pixels.reshape(-1, 2).astype(np.float64)

    def rays(self, pixels: Array) -> Array:
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        ideal = cv2.undistortPoints(
            pixels.reshape(-1, 1, 2), self.matrix, np.array(self.lens), None, None, None, criteria
        )
        return np.concatenate([ideal.reshape(-1, 2), np.ones((len(pixels), 1))], axis=1)

    @property
    def matrix(self) -> Array:
        return np.array([[self.focal, 0, self.centre[0]], [0, self.focal, self.centre[1]], [0, 0, 1.0]])


@dataclass(frozen=True)
class Rig:
    """X_projector = rotation X_camera + translation, in metres."""

    camera: Device
    projector: Device
    rotation: Array
    translation: Array


@dataclass(frozen=True)
class Place:
    """X_world = rotation X_camera + translation."""

    rotation: Array
    translation: Array


def draw_rig(rng: np.random.Generator, tangential: float) -> Rig:
    def lens(k1: float, k2: float) -> tuple[float, float, float, float, float]:
        p1, p2 = rng.normal(0, tangential, 2)
        return k1, k2, p1, p2, 0.0

    camera = Device(_CAMERA, 478.0, (319.5 + rng.normal(0, 7), 255.5 + rng.normal(0, 7)), lens(-0.07, 0.012))
    projector = Device(_PROJECTOR, 690.0, (428.0 + rng.normal(0, 4), 372.0 + rng.normal(0, 8)), lens(-0.02, 0.0))
    turn = Rotation.from_euler("yxz", [-rng.uniform(6, 9), -rng.uniform(8, 12), rng.normal(0, 1.5)], degrees=True)
    centre = np.array([0.34, rng.uniform(-0.02, 0.1), rng.uniform(-0.03, 0.06)])
    rotation = turn.as_matrix().T
    return Rig(camera, projector, rotation, -rotation @ centre)


def world_rays(rig: Rig, place: Place, pixels: Array) -> tuple[Array, Array]:
    directions = rig.camera.rays(pixels.reshape(-1, 2)) @ place.rotation.T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.broadcast_to(place.translation, directions.shape), directions
