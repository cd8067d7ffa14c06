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
    """A capture of a room or of a thing, with its pose."""

    number: int
    """Of the capture among all, from 0."""
    decoded: Decoded
    cloud: Cloud
    """In the camera's frame."""
    plane: NDArray[np.int32]
    """The room's plane of each pixel, −1 for none, (H, W)."""
    place: Pose
    """X_room = rotation X_camera + translation."""
    sigma_deg: Floats
    """Of its rotation about the room's axes, relative to the first station; NaN in undetermined directions."""
    sigma: Floats
    """Of its translation, the same, (3,)."""
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
    """Everything in the room's frame, z up, and the unit of `calibration`."""

    calibration: Calibration
    uncertainty: Uncertainty | None
    """Of the calibration, None if unknown."""
    stations: tuple[Station, ...]
    """Those of `group`, in its order."""
    planes: tuple[Plane, ...]
    estimate: RoomEstimate
    """As it was made, in baselines."""
    upright: Pose
    """X_room = rotation X_estimate + translation; then lengths are multiplied by `factor`."""
    factor: float
    group: Group
    pairs: tuple[Pair, ...]
    """Pairs of captures, by number."""
    names: tuple[str, ...]
    """Of all captures."""
    outlier_stations: tuple[OutlierStation, ...]
    findings: tuple[Finding, ...]
    floor: int | None
    """Number of the floor's plane."""
    areas: Floats
    """Visible area of each plane, in squares of the unit, (P,)."""

    @property
    def unit(self) -> str:
        """Of all lengths."""
        return self.calibration.unit
