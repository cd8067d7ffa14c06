"""What the pages of rooms and of things show alike of their stations."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics
from calib.pointcloud import MergedCloud
from scanner.quantities import shown_unit
from scanner.rendering import BLUE, Wireframe, frustum
from scanner.reporting import (
    CAMERA_COLOUR,
    ScaledMap,
    Thinned,
    View3d,
    device_lines,
    looking,
    maps,
    picture,
    turning_view,
)
from scanner.rooms.contents import Station

HALF_PX = 480
_SHOWN_SHARE = 99


@dataclass(frozen=True)
class Cell:
    """A cell of the overlap matrix: its text, and how dark it is, up to 1."""

    text: str
    shade: float


def overlap_cells(
    stations: Sequence[int], shares: Mapping[tuple[int, int], float], text: Callable[[tuple[int, int]], str]
) -> list[list[Cell]]:
    """What each two stations share, and its `text`; a pair has the lower number first."""

    def cell(row: int, column: int) -> Cell:
        pair = (min(row, column), max(row, column))
        share = 0.0 if row == column else shares.get(pair, 0.0)
        return Cell("" if row == column else text(pair) if share else "·", share)

    return [[cell(row, column) for column in stations] for row in stations]


def camera_frusta(stations: Sequence[Station], camera: Intrinsics, cloud: MergedCloud, share: float) -> list[Wireframe]:
    """The stations' cameras, as long as this share of the cloud."""
    length = share * float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    return [Wireframe(station.to_room(frustum(camera, length)), BLUE) for station in stations]


def turning_stations(stations: Sequence[Station], camera: Intrinsics, cloud: MergedCloud, share: float) -> View3d:
    """The cloud, z up, to be turned, with the stations' cameras by number, as long as this share of the cloud."""
    length = share * float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    lines = [
        line
        for number, station in enumerate(stations, start=1)
        for line in device_lines(camera, station.place, length, CAMERA_COLOUR, str(number))
    ]
    orientation = looking(np.array([1.0, 0.8, 0.0]), np.array([0.0, 0.0, 1.0]), cloud.points)
    return turning_view(Thinned.of(cloud.points, cloud.colours, cloud.normals), orientation, lines, cloud.unit)


def sigma_cells(station: Station, first: Station, unit: str) -> tuple[str, str]:
    """The sigmas of a station's place and of its turn, relative to the first one, which is held."""
    if station is first:
        return "held", "held"
    sigma, sigma_deg = (float(np.linalg.norm(axes)) for axes in (station.sigma, station.sigma_deg))
    return shown_unit(unit).error(sigma), f"{sigma_deg:.2g}°"


def residual_map(values: NDArray[np.float32], unit: str, alt: str) -> ScaledMap:
    """Of signed values (H, W), NaN for none; the scale leaves out the farthest few."""
    known = np.abs(values[np.isfinite(values)])
    limit = float(np.percentile(known, _SHOWN_SHARE)) if len(known) and known.any() else 1e-3
    painted, scale = maps.signed_map(values, limit, unit, HALF_PX)
    return ScaledMap(picture(painted, alt), scale)
