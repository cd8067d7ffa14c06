"""The scale from a length that is known: what to write into the configuration, where every length gets its scale."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Calibration
from scanner.measuring import DistanceMeasurement

_LARGEST_SHARE = 0.2  # largest share of a length that its sigma may have in a configuration


@dataclass(frozen=True)
class KnownScale:
    """`scale.baseline_m` and `scale.sigma_m` of a configuration: the baseline that makes a measured distance as long as
    it is known to be.
    """

    baseline_m: float
    sigma_m: float

    @property
    def keys(self) -> dict[str, float]:
        """Return the scale as keys of the configuration file."""
        return {"scale.baseline_m": float(f"{self.baseline_m:.7g}"), "scale.sigma_m": float(f"{self.sigma_m:.3g}")}

    @property
    def line(self) -> str:
        """Return the scale as a line of the configuration file."""
        baseline_m, sigma_m = self.keys.values()
        return f"scale: {{baseline_m: {baseline_m}, sigma_m: {sigma_m}}}"


def scale_from(
    distance: DistanceMeasurement, calibration: Calibration, known_m: float, sigma_m: float
) -> KnownScale | None:
    """Return the scale from two points whose distance is `known_m` ± `sigma_m`; None if the points are too uncertain.

    The scan measures the baseline relative to the distance, in any unit: the sigma does not include that of the present
    scale.
    """
    baseline_m = calibration.baseline / distance.distance * known_m
    budget = distance.budget
    measured = 0.0 if budget is None else np.sqrt(budget.sigma**2 - budget.scale**2) / distance.distance
    relative = float(np.hypot(measured, sigma_m / known_m))
    return KnownScale(baseline_m, relative * baseline_m) if relative < _LARGEST_SHARE else None
