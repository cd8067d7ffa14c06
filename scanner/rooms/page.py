"""report.html of a room: the verdict, the measurements, and the connections between stations.

What the pages of rooms and of things show alike of their stations.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics
from calib.pointcloud import MergedCloud
from scanner.quantities import percent, plain, rig_quantities, shown_unit
from scanner.rendering import BLUE, Wireframe, frustum, page, render, view_along
from scanner.reporting import (
    CAMERA_COLOUR,
    VIEWER,
    PageImage,
    ScaledMap,
    Thinned,
    View3d,
    device_lines,
    extent_row,
    files_beside,
    looking,
    maps,
    picture,
    turning_view,
)
from scanner.results import ROOM, Provenance
from scanner.rooms.contents import SolvedRoom, Station
from scanner.rooms.floorplan import FloorPlan, plan_svg
from scanner.rooms.verdict import verdict_on

HALF_PX = 480
_SHOWN_SHARE = 99
_VIEW = (960, 640)
_FRUSTUM_OF_SIZE = 0.05


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


def write_page(path: Path, room: SolvedRoom, plan: FloorPlan, cloud: MergedCloud, made: Provenance) -> None:
    """Write the page; it needs no network and no other file. Raises OSError."""
    text = page(
        "room.html",
        verdict=verdict_on(room),
        provenance=made,
        subtitle=f"{len(room.stations)} stations of one rig, {len(cloud.points):,} points.",
        plan=plan_svg(plan),
        runs=VIEWER,
        views=_views(room, cloud),
        view3d=turning_stations(room.stations, room.calibration.camera, cloud, _FRUSTUM_OF_SIZE),
        lengths=[extent_row(cloud.points, room.unit, "x, y and z"), *_lengths(room, plan)],
        stations=[_station_row(room, number, station) for number, station in enumerate(room.stations)],
        names=[str(number) for number in range(1, len(room.stations) + 1)],
        overlaps=_overlaps(room),
        pairs=list(_pairs(room)),
        residuals=[(station.name, _missed(station)) for station in room.stations],
        tables=rig_quantities(room.calibration),
        files=files_beside(path, ROOM),
        unit=room.unit,
    )
    path.write_text(text, encoding="utf-8")


def _views(room: SolvedRoom, cloud: MergedCloud) -> list[PageImage]:
    """From two sides above, and from straight above; walls that one would look at from behind are left out."""
    frusta = camera_frusta(room.stations, room.calibration.camera, cloud, _FRUSTUM_OF_SIZE)
    up = np.array([0.0, 0.0, 1.0])
    views = {
        "From one corner, above": (view_along(np.array([1.0, 0.8, -0.9]), up), _VIEW),
        "From the opposite one": (view_along(np.array([-1.0, -0.8, -0.9]), up), (HALF_PX, HALF_PX)),
        "From straight above": (view_along(-up, np.array([0.0, 1.0, 0.0])), (HALF_PX, HALF_PX)),
    }
    return [
        picture(render(cloud, view, drawn, frusta), f"the room, {name.lower()}", caption=f"{name}. Cameras in blue.")
        for name, (view, drawn) in views.items()
    ]


def _lengths(room: SolvedRoom, plan: FloorPlan) -> Iterator[tuple[str, str, str]]:
    """What was measured: name, value with sigma, meaning."""
    unit = shown_unit(room.unit)
    for line in plan.lines:
        if line.length is not None:
            (a, b) = ((line.start + line.end) / 2).tolist()
            where = f"along the floor, from corner to corner; its middle is at ({plain(a, 2)}, {plain(b, 2)})"
            yield f"wall, plane {line.plane}", unit.length(line.length.value, line.length.sigma), where
    for first, second, apart in plan.gaps:
        yield (
            f"between planes {first} and {second}",
            unit.length(apart.value, apart.sigma),
            "walls that face each other",
        )
    if plan.height is not None:
        yield "height", unit.length(plan.height.value, plan.height.sigma), "from floor to ceiling"
    for corner in plan.corners:
        angle = f"{plain(corner.angle_deg.value, 4)} ± {plain(corner.angle_deg.sigma, 4)}°"
        yield f"corner of planes {corner.planes[0]} and {corner.planes[1]}", angle, "inside the room"


def _station_row(room: SolvedRoom, number: int, station: Station) -> tuple[str, ...]:
    unit = shown_unit(room.unit)
    place = ", ".join(unit.number(value) for value in station.place.translation.tolist())
    return (
        str(number + 1),
        station.name,
        f"{place} {unit.name}",
        *sigma_cells(station, room.stations[0], room.unit),
        f"{len(station.decoded.matches):,}",
        "–" if np.isnan(station.residual_px) else f"{station.residual_px:.3f}",
    )


def _overlaps(room: SolvedRoom) -> list[list[Cell]]:
    """Shares of surfaces that stations share, by station."""
    shares = {(min(pair.first, pair.second), max(pair.first, pair.second)): pair.overlap for pair in room.pairs}
    return overlap_cells(room.group.stations, shares, lambda pair: percent(shares[pair]))


def _pairs(room: SolvedRoom) -> Iterator[tuple[str, ...]]:
    """Each overlapping pair: its weight as evidence, and its own solution."""
    unit = shown_unit(room.unit)
    order = {station: str(number) for number, station in enumerate(room.group.stations, start=1)}
    for pair in sorted(room.pairs, key=lambda pair: -pair.overlap):
        if pair.first not in order or pair.second not in order:
            continue
        yield (
            f"{order[pair.first]} – {order[pair.second]}",
            percent(pair.overlap),
            percent(pair.contradiction),
            f"{100 * pair.residual:.3f} %",
            unit.error(room.factor * pair.closure),
            f"{pair.nats:.0f}",
        )


def _missed(station: Station) -> ScaledMap:
    return residual_map(
        station.cloud.residual_px, "px", f"misses of the rays over the camera's image of {station.name}"
    )
