"""Things with flat and repeated sides: wrong poses meet much of the surface, sometimes more than the right ones do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from scanner.objects.contents import SolvedObject
from scanner.objects.solve import solve_object
from scanner.objects.verdict import verdict_on
from scanner.stations import RigStart
from scanner.ui import Terminal
from tests.support.things import ThingStation, between, config_for, decoded, thing_stations

pytestmark = pytest.mark.xdist_group("objects")

CAMERA = (230, 192)
Solved = tuple[list[ThingStation], SolvedObject]


@pytest.fixture(autouse=True)
def _open3d() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)


def box(sides: tuple[float, float, float], *middle: float) -> Any:
    return trimesh.creation.box(sides).apply_translation(middle)


def solved(parts: list[Any], step_deg: float, folder: Path) -> Solved:
    whole: Any = trimesh.util.concatenate(parts)
    whole.export(folder / "thing.ply")
    stations = thing_stations(
        [*range(6)], CAMERA, seed=1, kind="file", file=str(folder / "thing.ply"), step_deg=step_deg, patches=0.0
    )
    rig = stations[0].calibration
    start = RigStart(rig.in_baselines, None, {}, rig)
    return stations, solve_object(decoded(stations, CAMERA, True), start, config_for(CAMERA), Terminal(quiet=True))


def off_deg(stations: list[ThingStation], found: SolvedObject) -> list[float]:
    """Errors of the rotations relative to the first station."""
    offs = []
    for station in found.stations[1:]:
        turn = between(found.stations[0].place, station.place).rotation
        true = between(stations[found.stations[0].number].place, stations[station.number].place).rotation
        offs.append(float(np.degrees(Rotation.from_matrix(turn @ true.T).magnitude())))
    return offs


def test_a_thing_that_looks_the_same_from_behind_is_ambiguous(tmp_path: Path) -> None:
    """Half of a turn later another part of the thing is in view, so that less of it can agree."""
    towers = [box((1, 0.5, 0.4), 0, 0, 0), box((0.2, 0.2, 0.3), 0.3, 0, 0.3), box((0.2, 0.2, 0.3), -0.3, 0, 0.3)]
    _, found = solved(towers, 40.0, tmp_path)
    verdict = verdict_on(found)
    assert verdict.grade == "refused"
    assert "more than one way" in verdict.headline
    assert 150 < max(alternative.turn_deg for alternative in found.alternatives) <= 180


def test_flat_sides_do_not_outweigh_what_speaks_against_them(tmp_path: Path) -> None:
    boss = trimesh.creation.cylinder(0.12, 0.3).apply_translation([0.15, 0.1, 0.2])
    bracket = [
        box((1, 0.6, 0.12), 0, 0, 0),
        box((0.12, 0.6, 0.8), -0.44, 0, 0.4),
        box((0.1, 0.1, 0.2), 0.4, -0.2, 0.15),
        boss,
    ]
    stations, found = solved(bracket, 30.0, tmp_path)
    assert verdict_on(found).grade == "good"
    assert len(found.stations) == 6
    assert 0 < max(off_deg(stations, found)) < 0.1
