"""The geometry of the rig, and random camera poses in front of the corner."""

from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import Floats
from hw.simulated.device import Optics, PlacedDevice

# The paper's rig (section 5.1), at its full camera resolution.
_PAPER_CAMERA = Optics(2448, 2048, 1791.1, (1256.3, 1054.3))
_PAPER_PROJECTOR = Optics(854, 480, 1247.3, (377.1, 234.0))
# A throw ratio of 0.74, which lights half a wall from the middle of a room.
SHORT_THROW = Optics(854, 480, 630.0, (419.0, 262.0))
_ROLL_DEG = 15.0
_ZOOMS = (1.0, 1.06, 0.95, 1.03)


@dataclass(frozen=True)
class RigGeometry:
    """Both devices at the paper's resolution, and X_projector = rotation X_camera + translation."""

    camera: Optics
    projector: Optics
    rotation: Floats
    translation: Floats

    def placed(self, camera_rotation: Floats, camera_centre: Floats) -> tuple[PlacedDevice, PlacedDevice]:
        """Camera and projector in the room, given the camera's rotation from the world (3, 3) and centre (3,)."""
        projector_rotation = self.rotation @ camera_rotation
        projector_centre = camera_centre - projector_rotation.T @ self.translation
        return (
            PlacedDevice(self.camera, camera_rotation, camera_centre),
            PlacedDevice(self.projector, projector_rotation, projector_centre),
        )


def draw_rig(rng: np.random.Generator, distortion: float, projector: Optics = _PAPER_PROJECTOR) -> RigGeometry:
    """The paper's intrinsics, or those of another projector, with random lens distortion.

    The devices are 0.3 to 0.6 m apart and converge at 2.2 to 3.2 m, with a roll of up to 8°.

    Distortion is that of ordinary machine-vision and projector lenses: up to 4 % in the camera's corners and 0.5 % in
    the projector's.
    """
    bearing = rng.uniform(0, 2 * np.pi)
    centre = np.array([np.cos(bearing), np.sin(bearing), rng.uniform(-0.4, 0.4)])
    centre *= rng.uniform(0.3, 0.6) / np.linalg.norm(centre)
    target = np.array([0.0, 0.0, rng.uniform(2.2, 3.2)]) + rng.uniform(-0.05, 0.05, 3)
    rotation = look_at(centre, target, np.array([0.0, -1.0, 0.0]), rng.uniform(-8, 8))
    camera_k1, camera_k2 = distortion * rng.uniform((-0.06, -0.005), (-0.01, 0.01))
    projector_k1, projector_k2 = distortion * rng.uniform((-0.03, -0.01), (0.01, 0.01))
    return RigGeometry(
        _with_lens(_PAPER_CAMERA, _PAPER_CAMERA.width, _PAPER_CAMERA.height, camera_k1, camera_k2),
        _with_lens(projector, projector.width, projector.height, projector_k1, projector_k2),
        rotation,
        -rotation @ centre,
    )


def draw_camera_pose(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Rotation from the world (3, 3) and centre (3,) of a camera on a tripod that looks down into the corner."""
    distance, azimuth, elevation = rng.uniform((2.0, 27.0, 25.0), (3.4, 63.0, 43.0))
    azimuth, elevation = np.radians([azimuth, elevation])
    centre = distance * np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    target = rng.uniform(-0.1, 0.35, 3)
    return look_at(centre, target, np.array([0.0, 0.0, 1.0]), rng.uniform(-_ROLL_DEG, _ROLL_DEG)), centre


def resized(optics: Optics, width: int, height: int) -> Optics:
    """The same optics with an image of another size. Focal length and principal point scale with its width."""
    return _with_lens(optics, width, height, optics.k1, optics.k2)


def zoomed(device: PlacedDevice, number: int) -> PlacedDevice:
    """The device of a network at pose `number`, with a focal length different from its neighbours'."""
    optics = device.optics
    return replace(device, optics=replace(optics, focal_px=_ZOOMS[number % len(_ZOOMS)] * optics.focal_px))


def _with_lens(optics: Optics, width: int, height: int, k1: float, k2: float) -> Optics:
    scale = width / optics.width
    x0, y0 = optics.principal_point_px
    return Optics(width, height, scale * optics.focal_px, (scale * x0, scale * y0), float(k1), float(k2))


def look_at(centre: Floats, target: Floats, up: Floats, roll_deg: float) -> Floats:
    """Rotation (3, 3) from the world into the frame (x right, y down, z forward) of a device at `centre` facing
    `target`.
    """
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cosine, sine = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    return np.stack([cosine * right + sine * down, cosine * down - sine * right, forward])
