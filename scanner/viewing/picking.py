"""Picked points, the measurements between them, and the scale of the configuration from a distance that is known."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Calibration
from calib.numerics import Floats
from scanner.measuring import DistanceMeasurement, PlacedPoints, PointNumber, angle_cells
from scanner.quantities import shown_unit

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


# Largest angle between a picked point and the ray of a click: about eight pixels of a window.
_REACH_RAD = 0.008
# Of two points within reach the nearer one is picked, unless it is about as close to the other.
_SAME_DEPTH = 0.02
_MOST = 3


def point_at(points: Floats, origin: Floats, direction: Floats) -> int | None:
    """The number of the point (N, 3) that a ray from `origin` (3,) meets first; None if it passes all by."""
    towards = direction / np.linalg.norm(direction)
    apart = points - origin
    depth = apart @ towards
    beside = np.sqrt(np.maximum(np.einsum("ni,ni->n", apart, apart) - depth**2, 0.0))
    within = np.flatnonzero((depth > 0) & (beside <= _REACH_RAD * depth))
    if not len(within):
        return None
    front = within[depth[within] <= (1 + _SAME_DEPTH) * depth[within].min()]
    return int(front[np.argmin(beside[front] / depth[front])])


@dataclass(frozen=True)
class Picked:
    """Points of scans in the order of the clicks."""

    scans: PlacedPoints
    points: tuple[PointNumber, ...] = ()

    def with_point(self, point: PointNumber) -> "Picked":
        """Add a point. After three points, or at a point that is already picked, start again with this one."""
        begins = len(self.points) == _MOST or point in self.points
        return Picked(self.scans, (point,) if begins else (*self.points, point))

    @property
    def places(self) -> Floats:
        """The positions of the points in the cloud's frame, (n, 3)."""
        return np.reshape([self.scans.position(point) for point in self.points], (-1, 3))

    @property
    def distance(self) -> DistanceMeasurement | None:
        """Between two points; None unless there are two."""
        match self.points:
            case (first, second):
                return self.scans.distance((first, second))
        return None

    def scale(self, known_m: float, sigma_m: float) -> KnownScale | None:
        """Return the scale that makes their distance `known_m`; None unless there are two points, precise enough."""
        distance = self.distance
        return None if distance is None else scale_from(distance, self.scans.errors.calibration, known_m, sigma_m)

    def text(self) -> str:
        """Describe the measurement (Markdown)."""
        unit = shown_unit(self.scans.unit)
        match self.points:
            case ():
                return "Click on a point of the cloud; on two for a distance, on three for the angle at the second."
            case (one,):
                x, y, z = (unit.number(float(value)) for value in self.scans.position(one))
                return f"{self.scans.name(one).capitalize()}: x {x}, y {y}, z {z} {unit.name}"
            case (first, second):
                distance = self.scans.distance((first, second))
                sigma = distance.budget.sigma if distance.budget else None
                return f"Distance: **{unit.length(distance.distance, sigma)}**"
            case (first, second, third):
                angle, sigma_cell = angle_cells(self.scans.angle((first, second, third)))
                return f"Angle: **{angle} {sigma_cell}**"
        raise ValueError(f"{len(self.points)} points selected: expected one, two or three")
