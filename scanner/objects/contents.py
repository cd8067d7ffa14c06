"""The estimate of a thing: its stations, their agreement, and its surface."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.diagnostics import PoseErrors, Uncertainty
from calib.finding import Finding
from calib.geometry import Calibration
from calib.numerics import Floats
from calib.objects import AlternativePose, Turntable
from scanner.exporting import Mesh
from scanner.rooms import OutlierStation, Station


@dataclass(frozen=True, eq=False)
class SolvedObject:
    """Everything in the thing's frame, z up, and the unit of `calibration`.

    `stations` have clouds of the thing alone, and sigmas of the rotation and of the thing's origin relative to the
    first one. `overlap`, `residual`: by pair of stations (in their order), as of
    `JointEstimate`. `apart` (H, W) of each station: distance of its points in front of the others' surfaces, NaN where
    unknown. `turntable`: None if the poses are not those of one; `axis` (2, 3): a point and a direction in the thing's
    frame. `loose`: stations that can rotate or slide. `rests`: share of the visible surfaces that did not move and was
    left out. `pose_errors`: for the calibration. `uncertainty`: of the calibration, None if unknown. `findings`: on it.
    """

    calibration: Calibration
    stations: tuple[Station, ...]
    overlap: Mapping[tuple[int, int], float]
    residual: Mapping[tuple[int, int], float]
    apart: tuple[NDArray[np.float32], ...]
    turntable: Turntable | None
    axis: Floats | None
    alternatives: tuple[AlternativePose, ...]
    loose: tuple[int, ...]
    outlier_stations: tuple[OutlierStation, ...]
    rests: float
    pose_errors: PoseErrors
    uncertainty: Uncertainty | None = None
    findings: tuple[Finding, ...] = ()

    @property
    def unit(self) -> str:
        """Of all lengths."""
        return self.calibration.unit


@dataclass(frozen=True, eq=False)
class ObjectSurface:
    """The `mesh`, in the thing's frame; `closed`: without holes.

    `volume`, if it is closed, and `area` with their standard deviations, in the mesh's unit. `bridged`: share of the
    area that no station saw; if it is large, the volume is None.
    """

    mesh: Mesh
    closed: bool
    volume: tuple[float, float] | None
    area: tuple[float, float]
    bridged: float
