"""A calibration that other data gave, of boards say, to be joined with captures of a corner."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.diagnostics import Uncertainty, with_further_terms
from calib.geometry import Calibration, Intrinsics, Matches
from calib.numerics import Floats
from calib.refinement import FURTHER_TERMS, SHARED, KnownRig
from calib.refinement.parameters import TANGENTIAL, THIRD_RADIAL


@dataclass(frozen=True)
class KnownCalibration:
    """A Gaussian summary: the most likely `calibration`, and the covariance of its columns and its length.

    Lens terms beyond these columns, and the shape of the pixels, stay as they are. How unsure they are has to be in
    the covariance, as what the columns would do in their place. `freer`: the same with lens terms that those data left
    out, for captures that contradict their being left out.
    """

    calibration: Calibration
    uncertainty: Uncertainty
    freer: "KnownCalibration | None" = None

    @cached_property
    def rig(self) -> KnownRig:
        """As a prior on what all captures share, for matches `without_further_terms`."""
        rig = self.uncertainty.rig
        camera, projector = (device.copy() for device in (rig.camera, rig.projector))
        camera[[*TANGENTIAL, *THIRD_RADIAL]] = projector[[*TANGENTIAL, *THIRD_RADIAL]] = 0.0
        covariance, further = self.uncertainty.covariance.copy(), list(FURTHER_TERMS)
        covariance[further] = covariance[:, further] = 0.0
        return KnownRig(replace(rig, camera=camera, projector=projector), covariance)

    def without_further_terms(self, matches: Matches) -> Matches:
        """The matches as devices with square pixels and two radial terms would have them."""
        return replace(
            matches,
            camera_px=_simplified(self.calibration.camera, matches.camera_px),
            projector_px=_simplified(self.calibration.projector, matches.projector_px),
        )

    def with_further_terms(self, found: Calibration) -> Calibration:
        """What was found from such matches, for the matches as they are."""
        return replace(
            found,
            camera=with_further_terms(found.camera, self.calibration.camera),
            projector=with_further_terms(found.projector, self.calibration.projector),
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


def simplified(device: Intrinsics) -> Intrinsics:
    """The same device with square pixels and its first two radial terms."""
    focal, (k1, k2, *_) = device.focal_px[0], device.distortion
    return replace(device, focal_px=(focal, focal), distortion=(k1, k2, 0.0, 0.0, 0.0))


def _simplified(device: Intrinsics, pixels: Floats) -> Floats:
    plain = simplified(device)
    return pixels if plain == device else plain.project(device.unproject(pixels))
