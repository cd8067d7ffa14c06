"""Measurements, and the points that they are of; every length is in the result's unit."""

from dataclasses import dataclass

import numpy as np

from calib.diagnostics import Budget, Spread, SystematicErrors
from calib.numerics import Floats, Ints
from scanner.measuring.scene_errors import ONLY_SCATTER, KnownLengths

# Share of the points in a form error; the rest may be outliers.
FORM_SHARE = 0.997
_DIAMETER = np.array([[0.0, 0.0, 0.0, 2.0]])  # from centre and radius


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
    """A sphere of nominally known diameter.

    `diameter` and `centre` (3,) are fitted together, and `errors` are relative to that fit; `nominal_errors` to a fit
    of the centre with the nominal diameter. `spread`: of centre and radius. `strays`: number of points in its image
    that belong to something else. `image_px`: centre (x, y) and radius of its image.
    """

    nominal_diameter: float
    diameter: float
    centre: Floats
    spread: Spread
    errors: FitErrors
    nominal_errors: FitErrors
    strays: int
    image_px: tuple[float, float, float]

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
