"""Measurements, and the points that they are of; every length is in the result's unit.

Errors of a scan that its matches share, and their effect on lengths, in one sentence for every page.
"""

from dataclasses import dataclass
from math import floor, log10

import numpy as np

from calib.diagnostics import Budget, Spread, SystematicErrors, Uncertainty, length_in_the_middle
from calib.geometry import Calibration
from calib.numerics import Floats, Ints
from scanner.quantities import UNKNOWN_UNIT, plain, shown_unit

ONLY_SCATTER = (
    "The calibration states no covariance: the sigmas contain only the matches' scatter and their smooth errors."
)
# Share of the points in a form error; the rest may be outliers.
FORM_SHARE = 0.997
_DIAMETER = np.array([[0.0, 0.0, 0.0, 2.0]])  # from centre and radius


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


@dataclass(frozen=True)
class FitErrors:
    """Distances of points from the fitted surface.

    `residual` (N,): signed distances; `pixel` (N, 2): the camera's column and row of each. For a sphere positive is
    outside, for a plane towards the camera.
    """

    residual: Floats
    pixel: Ints

    @property
    def mean_absolute(self) -> float:
        """Mean of the distances: the MAE of the literature."""
        return float(np.mean(np.abs(self.residual)))

    @property
    def rms(self) -> float:
        """Root of the mean square."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def form(self) -> float:
        """Width of the band around the median that holds 99.7 % of the points."""
        low, high = np.quantile(self.residual, ((1 - FORM_SHARE) / 2, (1 + FORM_SHARE) / 2))
        return float(high - low)


@dataclass(frozen=True)
class SphereMeasurement:
    """A sphere of nominally known diameter."""

    nominal_diameter: float
    diameter: float
    """Fitted together with the centre."""
    centre: Floats
    """Fitted together with the diameter, (3,)."""
    spread: Spread
    """Of centre and radius."""
    errors: FitErrors
    """Relative to the fit of centre and diameter."""
    nominal_errors: FitErrors
    """Relative to a fit of the centre with the nominal diameter."""
    strays: int
    """Number of points in its image that belong to something else."""
    image_px: tuple[float, float, float]
    """Centre (x, y) and radius of its image."""

    @property
    def diameter_budget(self) -> Budget:
        """The error budget of the diameter."""
        return self.spread.through(_DIAMETER).budget()


@dataclass(frozen=True)
class FaceMeasurement:
    """A face of the corner: the plane `normal` · X = `offset` (the normal faces the camera) and its flatness.

    `deviation`: root mean square of the smooth part of its points' distances from the plane, without the scatter of
    single matches; `budget`: the contribution of the scanner.
    """

    name: str
    normal: Floats
    offset: float
    errors: FitErrors
    deviation: float
    budget: Budget


@dataclass(frozen=True)
class AngleMeasurement:
    """The angle between two faces, on the camera's side."""

    faces: tuple[str, str]
    angle_deg: float
    budget: Budget


@dataclass(frozen=True)
class PointAngle:
    """The angle at the second of three `points` (3, 3), between the lines to the others; `budget` None where
    unknown.
    """

    points: Floats
    angle_deg: float
    budget: Budget | None


@dataclass(frozen=True)
class DistanceMeasurement:
    """Distance between the points at two camera pixels, or between the centres of two spheres; `budget` None if
    unknown.

    `points` (2, 3), and their `names`.
    """

    names: tuple[str, str]
    points: Floats
    distance: float
    budget: Budget | None


@dataclass(frozen=True)
class MeasuredScene:
    """What every result has measured: faces and angles, if it has faces; the `errors` that all its points share; how
    well `lengths` are known, None where the calibration's covariance is not.
    """

    faces: tuple[FaceMeasurement, ...]
    angles: tuple[AngleMeasurement, ...]
    errors: SystematicErrors
    lengths: KnownLengths | None

    @property
    def sentence(self) -> str:
        """State the uncertainty of lengths in a sentence."""
        return ONLY_SCATTER if self.lengths is None else self.lengths.sentence


@dataclass(frozen=True)
class Measurements:
    """Everything that was measured in one result."""

    unit: str
    scene: MeasuredScene
    spheres: tuple[SphereMeasurement, ...] = ()
    distances: tuple[DistanceMeasurement, ...] = ()

    @property
    def pictured(self) -> bool:
        """Whether there is something to draw a heat map of."""
        return bool(self.spheres or self.scene.faces)
