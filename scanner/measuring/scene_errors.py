"""Errors of a scan that its matches share, and their effect on lengths, in one sentence for every page."""

from dataclasses import dataclass
from math import floor, log10

import numpy as np

from calib.diagnostics import Budget, SystematicErrors, Uncertainty, length_in_the_middle
from calib.geometry import Calibration
from calib.numerics import Floats
from scanner.quantities import UNKNOWN_UNIT, plain, shown_unit

ONLY_SCATTER = (
    "The calibration states no covariance: the sigmas contain only the matches' scatter and their smooth errors."
)


@dataclass(frozen=True)
class KnownLengths:
    """The uncertainty of lengths in the middle of a scene: `budget` is relative; `middle` (3,) is the position, in
    `unit`.
    """

    budget: Budget
    middle: Floats
    unit: str
    scale_sigma: float | None
    anchor: str
    baselines: str
    """What the unit of a result without a known length is."""

    @property
    def sentence(self) -> str:
        """'1000 mm in the middle of this scene are known to ± 0.4 mm', and what that takes as exact."""
        if self.unit == UNKNOWN_UNIT:
            return (
                f"No real length is known yet: sizes are in {self.baselines}, right to ± "
                f"{_two_digits(100 * self.budget.sigma)} %. Give one length to get millimetres (scale.baseline_m)."
            )
        unit = shown_unit(self.unit)
        # The largest power of ten below the distance of the scene.
        length = 10.0 ** floor(log10(unit.factor * float(np.linalg.norm(self.middle))))
        exact = "" if self.scale_sigma else f", taking {self.anchor} that was given as exact"
        known = _two_digits(self.budget.sigma * length)
        whole = f"{plain(length, max(0, -round(log10(length))))} {unit.name}"
        return f"{whole} in the middle of this scene are known to ± {known} {unit.name}{exact}."


def _two_digits(value: float) -> str:
    return plain(value, max(0, 1 - floor(log10(value)))) if value > 0 else "0"


def rig_errors(calibration: Calibration, uncertainty: Uncertainty | None) -> SystematicErrors:
    """Return the rig's errors, with the scale fixed by the baseline."""
    sigma = calibration.sigma.known_baseline or 0.0
    return SystematicErrors.of(calibration, uncertainty, sigma / calibration.baseline)


def known_lengths(points: Floats, errors: SystematicErrors) -> KnownLengths | None:
    """Return the uncertainty of lengths around the middle of points (N, 3); None without points, or without the
    calibration's covariance.
    """
    if not errors.known or not len(points):
        return None
    calibration = errors.calibration
    to_corner = calibration.sigma.known_camera_to_corner
    return KnownLengths(
        length_in_the_middle(points, errors),
        np.median(points, axis=0),
        calibration.unit,
        calibration.sigma.known_baseline if to_corner is None else to_corner,
        "the baseline" if to_corner is None else "the distance from camera to corner",
        "distances between the first two photos" if calibration.one_camera else "camera–projector distances",
    )
