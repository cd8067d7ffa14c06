"""report.html of a room: the verdict, the measurements, and the connections between stations."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.pointcloud import MergedCloud
from scanner.quantities import percent, plain, rig_quantities, shown_unit
from scanner.rendering import page, render, view_along
from scanner.reporting import VIEWER, PageImage, ScaledMap, extent_row, files_beside, picture
from scanner.results import ROOM, Provenance
from scanner.rooms.contents import SolvedRoom, Station
from scanner.rooms.floorplan import FloorPlan
from scanner.rooms.floorplan_drawings import plan_svg
from scanner.rooms.page_parts import (
    HALF_PX,
    Cell,
    camera_frusta,
    overlap_cells,
    residual_map,
    sigma_cells,
    turning_stations,
)
from scanner.rooms.verdict import verdict_on

_VIEW = (960, 640)
_FRUSTUM_OF_SIZE = 0.05


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
    for one, other, apart in plan.gaps:
        yield f"between planes {one} and {other}", unit.length(apart.value, apart.sigma), "walls that face each other"
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
