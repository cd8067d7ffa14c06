"""Stations whose rig changed so little that only all planes together reveal it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.rooms import changed_extrinsics
from tests.calib.rooms.conftest import Case
from tests.support.known_rigs import cells_of


def turned(case: Case, station: int, turn_deg: tuple[float, float, float]) -> Case:
    """The room with one station's projector rotated about its own axes."""
    projector, stations = case.made.calibration.projector, list(case.made.stations)
    matches = stations[station].matches
    rays = projector.unproject(matches.projector_px) @ Rotation.from_rotvec(turn_deg, degrees=True).as_matrix().T
    stations[station] = replace(stations[station], matches=replace(matches, projector_px=projector.project(rays)))
    made = replace(case.made, stations=tuple(stations))
    labels = [np.unique(each.matches.labels[each.matches.labels >= 0]).tolist() for each in stations]
    cells, _ = cells_of(made, [dict(zip(*each, strict=True)) for each in zip(labels, case.plane_of, strict=True)])
    found = replace(case, made=made, cells=cells)
    return replace(found, found=found.estimate())


def test_unchanged_rigs_are_not_reported(case: Case) -> None:
    assert changed_extrinsics(case.found) == ()


@pytest.mark.parametrize(("station", "turn_deg"), [(2, (0.0, 0.02, 0.0)), (4, (0.01, 0.0, 0.03))])
def test_a_small_rotation_is_found_with_its_size(
    case: Case, station: int, turn_deg: tuple[float, float, float]
) -> None:
    (found,) = changed_extrinsics(turned(case, station, turn_deg).found)
    assert found.station == station
    assert found.turn_deg == pytest.approx(float(np.linalg.norm(turn_deg)), rel=0.2)
    assert 0.01 < found.px < 0.5
