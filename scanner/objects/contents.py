"""What is known of a thing: its stations, how they lie on each other, and its surface."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration
from calib.numerics import Floats
from calib.objects import Alternative, Turntable
from scanner.exporting.triangles import Mesh
from scanner.rooms.contents import Station


@dataclass(frozen=True)
class OutlierStation:
    """A capture that is no station of this thing, and why: in a word or two for programs, and in a sentence."""

    name: str
    cause: Literal["nothing seen", "no overlap", "does not fit"]
    reason: str


@dataclass(frozen=True, eq=False)
class SolvedObject:
    """In the thing's frame, z up, the unit of `calibration`. `stations` have clouds of the thing alone, and sigmas of
    the turn and of the thing's origin against the first one; `numbers` of them among all captures.

    `overlap`, `residual`: by pair of stations (in their order), as of `JointEstimate`. `apart` (H, W) of each station:
    how far its pixels' points are before the others' surfaces, NaN where nothing tells. `turntable`: None where the
    places are not those of one; `axis` (2, 3): a point and a direction in the thing's frame. `loose`: stations that can
    turn or slide. `rests`: share of what was seen that did not move and was left out.
    """

    calibration: Calibration
    stations: tuple[Station, ...]
    numbers: tuple[int, ...]
    overlap: Mapping[tuple[int, int], float]
    residual: Mapping[tuple[int, int], float]
    apart: tuple[NDArray[np.float32], ...]
    turntable: Turntable | None
    axis: Floats | None
    alternatives: tuple[Alternative, ...]
    loose: tuple[int, ...]
    outlier_stations: tuple[OutlierStation, ...]
    rests: float

    @property
    def unit(self) -> str:
        """Of all lengths."""
        return self.calibration.unit


@dataclass(frozen=True, eq=False)
class Surface:
    """The `mesh`, in the thing's frame; `closed`: without holes. `volume`, where it is closed, and `area` with their
    standard deviations, in the mesh's unit; `bridged`: share of the area that no station saw. Where that is large, the
    volume is None.
    """

    mesh: Mesh
    closed: bool
    volume: tuple[float, float] | None
    area: tuple[float, float]
    bridged: float
