"""What is known of a whole room: its stations, how they belong together, and the estimate of all of it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.diagnostics import Uncertainty
from calib.finding import Finding
from calib.geometry import Calibration, Plane, Pose
from calib.numerics import Floats
from calib.pointcloud import Cloud
from calib.registration import Group, Pair
from calib.rooms import RoomEstimate
from scanner.results import Decoded


@dataclass(frozen=True, eq=False)
class Station:
    """A capture of a room or of a thing, with its pose. `number`: of the capture among all, from 0. `cloud` is in the
    camera's frame, `plane` (H, W) is the room's plane of a pixel, −1 for none.

    `place`: X_room = rotation X_camera + translation. `sigma_deg`, `sigma` (3,): of its rotation about the room's axes
    and of its translation, relative to the first station; NaN in undetermined directions.
    """

    number: int
    decoded: Decoded
    cloud: Cloud
    plane: NDArray[np.int32]
    place: Pose
    sigma_deg: Floats
    sigma: Floats
    residual_px: float

    @property
    def name(self) -> str:
        """Which capture it is."""
        return self.decoded.name

    def to_room(self, points: Floats) -> Floats:
        """Points (..., 3) of the camera's frame in the room's."""
        return self.place @ points


@dataclass(frozen=True)
class OutlierStation:
    """A capture that belongs to no room or thing."""

    name: str
    finding: Finding
    """Why; the message is a clause about it."""

    @property
    def warning(self) -> Finding:
        """The finding as a sentence that names the capture."""
        return replace(self.finding, message=f"{self.name} is left out: {self.finding.message}.")


@dataclass(frozen=True, eq=False)
class SolvedRoom:
    """Everything in the room's frame, z up, and the unit of `calibration`; `estimate` is the original, in baselines.

    `stations` are those of `group`, in its order; `names` are of all captures; `pairs` refer to them by number.
    `uncertainty`: of the calibration, None if unknown. `floor`: number of its plane. `areas` (P,): visible area of each
    plane, in squares of the unit. `upright`: X_room = rotation X_estimate + translation; then lengths are multiplied by
    `factor`.
    """

    calibration: Calibration
    uncertainty: Uncertainty | None
    stations: tuple[Station, ...]
    planes: tuple[Plane, ...]
    estimate: RoomEstimate
    upright: Pose
    factor: float
    group: Group
    pairs: tuple[Pair, ...]
    names: tuple[str, ...]
    outlier_stations: tuple[OutlierStation, ...]
    findings: tuple[Finding, ...]
    floor: int | None
    areas: Floats

    @property
    def unit(self) -> str:
        """Of all lengths."""
        return self.calibration.unit
