"""report.html of a thing: whether it can be trusted, views from all around, what its stations share."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.pointcloud import MergedCloud
from scanner.objects.contents import ObjectSurface, SolvedObject
from scanner.objects.verdict import verdict_on
from scanner.quantities import percent, shown_unit
from scanner.rendering import page, render, view_along
from scanner.reporting import VIEWER, PageImage, ScaledMap, extent_row, files_beside, picture
from scanner.results import OBJECT, Provenance
from scanner.rooms.page import (
    HALF_PX,
    Cell,
    camera_frusta,
    overlap_cells,
    residual_map,
    sigma_cells,
    turning_stations,
)

_VIEW = (960, 640)
_FRUSTUM_OF_SIZE = 0.15
_UP = np.array([0.0, 0.0, 1.0])


def write_page(
    path: Path, solved: SolvedObject, surface: ObjectSurface | None, cloud: MergedCloud, made: Provenance
) -> None:
    """Write the page; it needs no network and no other file. Raises OSError."""
    text = page(
        "object.html",
        verdict=verdict_on(solved),
        provenance=made,
        subtitle=f"{len(solved.stations)} stations of one rig, {len(cloud.points):,} points.",
        runs=VIEWER,
        views=_views(solved, cloud),
        view3d=turning_stations(solved.stations, solved.calibration.camera, cloud, _FRUSTUM_OF_SIZE),
        measured=[extent_row(cloud.points, solved.unit, "x, y and z"), *_measured(solved, surface)],
        stations=list(_station_rows(solved)),
        names=[str(number) for number in range(1, len(solved.stations) + 1)],
        overlaps=_matrix(solved),
        residuals=list(_residuals(solved)),
        files=files_beside(path, OBJECT),
        unit=solved.unit,
    )
    path.write_text(text, encoding="utf-8")


def _views(solved: SolvedObject, cloud: MergedCloud) -> list[PageImage]:
    """From four sides, and from above with the cameras."""
    frusta = camera_frusta(solved.stations, solved.calibration.camera, cloud, _FRUSTUM_OF_SIZE)
    pictures = [
        picture(
            render(cloud, view_along(np.array([1.0, 0.8, -0.9]), _UP), _VIEW, frusta),
            "the thing, above",
            caption="From above, with the cameras in blue as they stood against the thing.",
        )
    ]
    for turn in range(4):
        along = np.array([np.cos(turn * np.pi / 2), np.sin(turn * np.pi / 2), -0.3])
        view = render(cloud, view_along(along, _UP), (HALF_PX, HALF_PX), [])
        pictures.append(picture(view, f"the thing from side {turn + 1}", caption=f"Side {turn + 1}."))
    return pictures


def _measured(solved: SolvedObject, surface: ObjectSurface | None) -> Iterator[tuple[str, str, str]]:
    """Name, value with sigma, meaning."""
    name = shown_unit(solved.unit).name
    factor = shown_unit(solved.unit).factor
    if surface is None:
        yield "volume", "not known", "the points do not hang together as a surface"
        return
    if surface.volume is None:
        holes = "the surface has holes where no station looked; --fill closes them"
        bridges = f"{percent(surface.bridged)} of the surface bridges holes, too much to know what is inside"
        yield "volume", "not known", bridges if surface.closed else holes
    else:
        volume, sigma = (value * factor**3 for value in surface.volume)
        filled = percent(surface.bridged)
        yield "volume", f"{volume:.6g} ± {sigma:.2g} {name}³", f"of the closed surface, {filled} of which bridges holes"
    area, sigma = (value * factor**2 for value in surface.area)
    yield "area", f"{area:.5g} ± {sigma:.2g} {name}²", "of the closed surface" if surface.closed else "of what was seen"


def _station_rows(solved: SolvedObject) -> Iterator[tuple[str, ...]]:
    for n, station in enumerate(solved.stations):
        angle = "" if solved.turntable is None else f"{solved.turntable.angles_deg[n]:.3f}°"
        sigmas = sigma_cells(station, solved.stations[0], solved.unit)
        yield str(n + 1), station.name, angle, *sigmas, f"{len(station.decoded.matches):,}"


def _residuals(solved: SolvedObject) -> Iterator[tuple[str, ScaledMap]]:
    unit = shown_unit(solved.unit)
    for station, apart in zip(solved.stations, solved.apart, strict=True):
        alt = f"distance in front of the surface of the others, over the camera's image of {station.name}"
        yield station.name, residual_map(apart * np.float32(unit.factor), unit.name, alt)


def _matrix(solved: SolvedObject) -> list[list[Cell]]:
    """What pairs share, and how far their surfaces are apart."""
    unit = shown_unit(solved.unit)

    def text(pair: tuple[int, int]) -> str:
        return f"{percent(solved.overlap[pair])}, {unit.error(solved.residual[pair])}"

    return overlap_cells(range(len(solved.stations)), solved.overlap, text)
