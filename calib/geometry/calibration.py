"""What a calibration is: two devices, the motion between them, and how sure of each we are."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calib.geometry.camera import Intrinsics
from calib.numerics import Floats


@dataclass(frozen=True)
class Calibration:
    """Intrinsics of both devices and X_projector = R X_camera + t.

    `rotation` (3, 3), `translation` (3,) in `unit` ('baseline' where no length is known: |t| = 1). `sigma` maps
    `camera_focal_px`, `projector_focal_px`, `projector_principal_point_px` … to standard deviations; empty if unknown.
    """

    camera: Intrinsics
    projector: Intrinsics
    rotation: Floats
    translation: Floats
    unit: str = "baseline"
    sigma: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise ValueError("rotation must be 3 × 3 and translation have 3 numbers")
        if not (np.all(np.isfinite(self.rotation)) and np.all(np.isfinite(self.translation))):
            raise ValueError("rotation and translation must be finite numbers")
        if not np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(self.rotation) < 0:
            raise ValueError("rotation must be orthonormal with determinant +1")
        if not np.linalg.norm(self.translation) > 0:
            raise ValueError("translation must not be zero: camera and projector would be in one place")

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
