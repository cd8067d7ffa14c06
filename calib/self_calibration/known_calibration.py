"""A calibration that other data gave, of boards say, to be joined with captures of a corner."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.diagnostics import Uncertainty, with_pixels_of
from calib.geometry import Calibration, Intrinsics, Matches
from calib.numerics import Floats
from calib.refinement import SHARED, KnownRig


@dataclass(frozen=True)
class KnownCalibration:
    """A Gaussian summary: the most likely `calibration`, and the covariance of its columns and its length.

    The shape of the pixels stays as it is. How unsure it is has to be in the covariance, as what the columns would do
    in its place.
    """

    calibration: Calibration
    uncertainty: Uncertainty

    @cached_property
    def rig(self) -> KnownRig:
        """As a prior on what all captures share, for matches `with_square_pixels`."""
        return KnownRig(self.uncertainty.rig, self.uncertainty.covariance)

    def with_square_pixels(self, matches: Matches) -> Matches:
        """The matches as devices with square pixels would have them."""
        return replace(
            matches,
            camera_px=_squared(self.calibration.camera, matches.camera_px),
            projector_px=_squared(self.calibration.projector, matches.projector_px),
        )

    def with_own_pixels(self, found: Calibration) -> Calibration:
        """What was found from such matches, for the matches as they are."""
        return replace(
            found,
            camera=with_pixels_of(found.camera, self.calibration.camera),
            projector=with_pixels_of(found.projector, self.calibration.projector),
        )

    def with_log_baseline(self, covariance: Floats) -> Floats:
        """The covariance of the baseline's logarithm with the columns, (21,), where theirs is now this one, (21, 21).

        Captures of a corner say nothing of lengths but through the columns.
        """
        moved: Floats = covariance[:SHARED, :SHARED] @ self.uncertainty.by_log_baseline
        return moved

    def metric(self, found: Calibration, uncertainty: Uncertainty) -> Calibration:
        """A calibration that was found together with this one, in baselines → in this one's unit, with its sigma."""
        known = self.calibration.sigma.known_baseline
        if known is None:
            return found
        gain = self.uncertainty.by_log_baseline
        log_baseline = float(gain @ self.rig.step_to(uncertainty.state))
        baseline = self.calibration.baseline * np.exp(log_baseline)
        own = (known / self.calibration.baseline) ** 2 - gain @ self.uncertainty.covariance @ gain
        variance = max(float(own), 0.0) + float(gain @ uncertainty.covariance @ gain)
        return replace(
            found,
            translation=found.translation * (baseline / found.baseline),
            unit=self.calibration.unit,
            sigma=replace(found.sigma, known_baseline=float(baseline * np.sqrt(variance))),
        )


def _squared(device: Intrinsics, pixels: Floats) -> Floats:
    (along_x, along_y), (_, y) = device.focal_px, device.principal_point_px
    if along_x == along_y:
        return pixels
    return np.stack([pixels[:, 0], y + (pixels[:, 1] - y) * along_x / along_y], axis=1)
