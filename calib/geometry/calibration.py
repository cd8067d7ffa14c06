"""A calibration: two devices, their relative pose, and their uncertainties."""

from dataclasses import dataclass, replace

import numpy as np

from calib.geometry.camera import Intrinsics, Size
from calib.geometry.pose import Pose
from calib.geometry.radial_distortion import PER_DEVICE
from calib.numerics import Floats


@dataclass(frozen=True)
class DeviceSigmas:
    """Standard deviations of `Intrinsics`, field by field; None where unknown. `distortion`: of its first terms."""

    focal_px: tuple[float, float] | None = None
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, ...] | None = None

    @classmethod
    def of_device(cls, device: Floats, covariance: Floats) -> "DeviceSigmas":
        """Those of `Intrinsics.of_device`, from the covariance (8, 8) or (9, 9) of a device's columns."""
        ratios = slice(1 + len(device) - PER_DEVICE)  # log f, log f_y / f_x
        x0, y0, *terms = np.sqrt(covariance.diagonal())[ratios.stop :].tolist()
        along_x, along_y = np.sqrt([covariance[0, 0], covariance[ratios, ratios].sum()]).tolist()
        focal_px = float(device[0]) * along_x, float(np.prod(device[ratios])) * along_y
        return cls(focal_px, (x0, y0), tuple(terms))


@dataclass(frozen=True)
class Sigmas:
    """Standard deviations of a calibration, None where unknown; 0 is a number that was held fixed."""

    camera: DeviceSigmas = DeviceSigmas()
    projector: DeviceSigmas = DeviceSigmas()
    rotation_deg: tuple[float, float, float] | None = None
    """About x, y, z."""
    translation_direction_deg: float | None = None
    """Of both directions across it, together."""
    corner_angles_deg: tuple[float, float, float] | None = None
    """Between the faces (B, C), (C, A), (A, B)."""
    known_baseline: float | None = None
    """Of the length that fixed the scale, in the calibration's unit, if that was the baseline."""
    known_camera_to_corner: float | None = None
    """The same, if it was the camera's distance from the corner's vertex."""


@dataclass(frozen=True)
class Calibration:
    """Intrinsics of both devices, their relative pose, and how well these numbers are known.

    Raises ValueError if the pose is not finite, is no rotation, or puts both devices in one place.
    """

    camera: Intrinsics
    projector: Intrinsics
    pose: Pose
    """X_projector = R X_camera + t, with t in `unit`."""
    unit: str = "baseline"
    """Of lengths; 'baseline' if none is known: |t| = 1."""
    sigma: Sigmas = Sigmas()
    """Standard deviations of these numbers."""

    def __post_init__(self) -> None:
        rotation, translation = self.pose.rotation, self.pose.translation
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise ValueError("rotation must be 3 × 3 and translation have 3 numbers")
        if not (np.all(np.isfinite(rotation)) and np.all(np.isfinite(translation))):
            raise ValueError("rotation and translation must be finite numbers")
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
            raise ValueError("rotation must be orthonormal with determinant +1")
        if not np.linalg.norm(translation) > 0:
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
        return self.pose.distance

    @property
    def projector_centre(self) -> Floats:
        """Centre of the projector in the camera's frame, (3,)."""
        return self.pose.inverse().translation

    @property
    def in_baselines(self) -> "Calibration":
        """The same with the baseline as the unit of length; sigmas are kept."""
        return replace(self, pose=self.pose.in_baselines, unit="baseline")

    def scaled(self, factor: float, unit: str | None = None) -> "Calibration":
        """The same with lengths multiplied by a factor, in another `unit` if one is given; sigmas are kept."""
        return replace(self, pose=self.pose.scaled(factor), unit=unit or self.unit)
