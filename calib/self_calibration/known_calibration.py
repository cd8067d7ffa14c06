"""A calibration from other data, such as boards, to be combined with captures of a corner."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.diagnostics import Uncertainty, with_pixels_of
from calib.geometry import Calibration, Intrinsics, Matches
from calib.numerics import Floats
from calib.refinement import SHARED, KnownRig


@dataclass(frozen=True)
class KnownCalibration:
    """A Gaussian summary: the most likely `calibration`, and the covariance of its parameters and its baseline.

    The pixel aspect ratio is held fixed. Its uncertainty must be included in the covariance, as the equivalent
    uncertainty of the parameters.
    """

    calibration: Calibration
    uncertainty: Uncertainty

    @cached_property
    def rig(self) -> KnownRig:
        """Return it as a prior on the parameters shared by all captures, for matches `with_square_pixels`."""
        return KnownRig(self.uncertainty.rig, self.uncertainty.covariance)

    def with_square_pixels(self, matches: Matches) -> Matches:
        """Return the matches as devices with square pixels would see them."""
        return replace(
            matches,
            camera_px=_squared(self.calibration.camera, matches.camera_px),
            projector_px=_squared(self.calibration.projector, matches.projector_px),
        )

    def with_own_pixels(self, calibration: Calibration) -> Calibration:
        """Convert a calibration found from `with_square_pixels` matches back to the devices' own pixels."""
        return replace(
            calibration,
            camera=with_pixels_of(calibration.camera, self.calibration.camera),
            projector=with_pixels_of(calibration.projector, self.calibration.projector),
        )

    def with_log_baseline(self, covariance: Floats) -> Floats:
        """Return the covariance (21,) of the log baseline with the parameters, given their new covariance (21, 21).

        Captures of a corner have no scale: they change the baseline only through its correlation with the parameters.
        """
        return covariance[:SHARED, :SHARED] @ self.uncertainty.by_log_baseline

    def metric(self, calibration: Calibration, uncertainty: Uncertainty) -> Calibration:
        """Convert a calibration combined with this one from baselines to this one's unit, with its sigma."""
        known = self.calibration.sigma.known_baseline
        if known is None:
            return calibration
        gain = self.uncertainty.by_log_baseline
        log_baseline = float(gain @ self.rig.step_to(uncertainty.state))
        baseline = self.calibration.baseline * np.exp(log_baseline)
        own = (known / self.calibration.baseline) ** 2 - gain @ self.uncertainty.covariance @ gain
        variance = max(float(own), 0.0) + float(gain @ uncertainty.covariance @ gain)
        sigma = replace(calibration.sigma, known_baseline=float(baseline * np.sqrt(variance)))
        return replace(calibration.scaled(baseline / calibration.baseline, self.calibration.unit), sigma=sigma)


def _squared(device: Intrinsics, pixels: Floats) -> Floats:
    (along_x, along_y), (_, y) = device.focal_px, device.principal_point_px
    if along_x == along_y:
        return pixels
    return np.stack([pixels[:, 0], y + (pixels[:, 1] - y) * along_x / along_y], axis=1)
