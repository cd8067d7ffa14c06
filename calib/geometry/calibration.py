"""A calibration: two devices, the motion between them, and their uncertainties."""

from dataclasses import dataclass

import numpy as np

from calib.geometry.camera import Intrinsics, Size
from calib.numerics import Floats


@dataclass(frozen=True)
class DeviceSigmas:
    """Standard deviations of `Intrinsics`, field by field; None where unknown. `distortion`: of its first terms."""

    focal_px: tuple[float, float] | None = None
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Sigmas:
    """Standard deviations of a calibration, None where unknown; 0 is a number that was held fixed.

    `rotation_deg`: about x, y, z; `translation_direction_deg`: of both directions across it, together;
    `corner_angles_deg`: between the faces (B, C), (C, A), (A, B). Of the one length that fixed the scale, in the
    calibration's unit: `known_baseline`, or `known_camera_to_corner`, the camera's distance from the corner's vertex.
    """

    camera: DeviceSigmas = DeviceSigmas()
    projector: DeviceSigmas = DeviceSigmas()
    rotation_deg: tuple[float, float, float] | None = None
    translation_direction_deg: float | None = None
    corner_angles_deg: tuple[float, float, float] | None = None
    known_baseline: float | None = None
    known_camera_to_corner: float | None = None


@dataclass(frozen=True)
class Calibration:
    """Intrinsics of both devices and X_projector = R X_camera + t.

    `rotation` (3, 3), `translation` (3,) in `unit` ('baseline' if no length is known: |t| = 1). `sigma`: standard
    deviations of these numbers.
    """

    camera: Intrinsics
    projector: Intrinsics
    rotation: Floats
    translation: Floats
    unit: str = "baseline"
    sigma: Sigmas = Sigmas()

    def __post_init__(self) -> None:
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise ValueError("rotation must be 3 × 3 and translation have 3 numbers")
        if not (np.all(np.isfinite(self.rotation)) and np.all(np.isfinite(self.translation))):
            raise ValueError("rotation and translation must be finite numbers")
        if np.abs(self.rotation @ self.rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(self.rotation) < 0:
            raise ValueError("rotation must be orthonormal with determinant +1")
        if not np.linalg.norm(self.translation) > 0:
            raise ValueError("translation must not be zero: camera and projector would be in one place")

    @property
    def sizes(self) -> tuple[Size, Size]:
        """Of the images of camera and projector."""
        return self.camera.size, self.projector.size

    @property
    def one_camera(self) -> bool:
        """Whether both devices are the same: one camera at two places."""
        return self.camera == self.projector

    @property
    def baseline(self) -> float:
        """Distance between the devices' centres, in `unit`."""
        return float(np.linalg.norm(self.translation))

    @property
    def projector_centre(self) -> Floats:
        """Centre of the projector in the camera's frame, (3,)."""
        return -self.rotation.T @ self.translation
