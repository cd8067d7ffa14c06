"""Stations of a simulated thing: poses, removal of the background, and refusals of ambiguous ones."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.deferred_imports import open3d
from calib.finding import Finding, Severity, of_kinds
from calib.geometry import Calibration, DeviceSigmas, Sigmas
from calib.refusal import RefusalError
from calib.scene import BY_SCENE, CALIBRATION_CHANGED
from scanner.objects.contents import SolvedObject
from scanner.objects.solve import solve_object
from scanner.objects.surface import area_of, cloud_of, is_closed, surface_of, volume_of
from scanner.objects.verdict import verdict_on
from scanner.rooms import CAMERA_FROM_ROOM
from scanner.stations import RigStart, read_stations
from scanner.ui import Terminal
from scanner.viewing import ViewedResult
from tests.support.things import ThingStation, between, config_for, decoded, thing_stations

pytestmark = pytest.mark.xdist_group("objects")  # what the module shares is made once

CAMERA = (306, 256)


@pytest.fixture(scope="module", autouse=True)
def _open3d() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)


def solved(stations: list[ThingStation], pictures: bool = True, calibration: Calibration | None = None) -> SolvedObject:
    """By the true calibration, or another one."""
    rig = calibration or stations[0].calibration
    start = RigStart(rig.in_baselines, None, {}, rig)
    return solve_object(decoded(stations, CAMERA, pictures), start, config_for(CAMERA), Terminal(quiet=True))


@pytest.fixture(scope="module")
def turned() -> tuple[list[ThingStation], SolvedObject]:
    stations = thing_stations([0, 3, 1, 4, 2], CAMERA, seed=2, steps=12)
    return stations, solved(stations)


def test_poses_are_found_without_order_or_initial_guess(turned: tuple[list[ThingStation], SolvedObject]) -> None:
    stations, found = turned
    assert tuple(each.number for each in found.stations) == (0, 1, 2, 3, 4)
    assert verdict_on(found).grade == "good"
    for true, station in zip(stations[1:], found.stations[1:], strict=True):
        off = between(found.stations[0].place, station.place)
        wanted = between(stations[0].place, true.place)
        turn_deg = np.degrees(Rotation.from_matrix((off @ wanted.inverse()).rotation).magnitude())
        assert 0 < turn_deg < 0.03
        assert turn_deg < 8 * np.linalg.norm(station.sigma_deg)
        middle = wanted.inverse().translation
        shift = np.linalg.norm(off @ middle - wanted @ middle)
        assert 0 < shift < 2e-4


def test_a_calibration_that_no_longer_holds_is_doubted(turned: tuple[list[ThingStation], SolvedObject]) -> None:
    stations, found = turned
    assert of_kinds(found.findings, CALIBRATION_CHANGED) == ()
    truth = stations[0].calibration
    (fx, fy) = truth.projector.focal_px
    zoomed = replace(truth, projector=replace(truth.projector, focal_px=(1.005 * fx, 1.005 * fy)))
    doubted = solved(stations[:4], calibration=zoomed)
    (finding,) = of_kinds(doubted.findings, CALIBRATION_CHANGED)
    assert "A change of the projector's focal length by 0.5 % ± 0.0" in finding.message
    verdict = verdict_on(doubted)
    assert verdict.grade == "fair"
    assert verdict.headline.endswith("but with a calibration that no longer holds.")
    assert finding in verdict.findings


def test_the_turntable_is_found(turned: tuple[list[ThingStation], SolvedObject]) -> None:
    _, found = turned
    assert found.turntable is not None
    steps = np.abs(found.turntable.angles_deg[[2, 4, 1, 3]])
    np.testing.assert_allclose(steps, [30, 60, 90, 120], atol=0.02)


def test_the_static_background_is_left_out(turned: tuple[list[ThingStation], SolvedObject]) -> None:
    stations, found = turned
    assert 0.4 < found.rests < 0.9
    for true, station in zip(stations, found.stations, strict=True):
        own = station.cloud.there
        assert np.count_nonzero(own & ~true.thing) < 0.02 * np.count_nonzero(own)
        assert np.count_nonzero(own) > 0.5 * np.count_nonzero(true.thing)


def test_a_plain_ball_is_ambiguous() -> None:
    stations = thing_stations([0, 1, 2], CAMERA, seed=5, steps=12, kind="ball", patches=0.0, background=False)
    verdict = verdict_on(solved(stations, pictures=False))
    assert verdict.grade == "refused"
    assert "more than one way" in verdict.headline
    assert "the same from several sides" in verdict.reasons[0]


def test_a_station_of_another_object_is_named_and_left_out() -> None:
    stations = thing_stations([0, 1, 2], CAMERA, seed=2, steps=12, background=False)
    stranger = thing_stations([0], CAMERA, seed=2, steps=12, background=False, kind="box")
    found = solved([*stations, *stranger])
    assert [outlier_station.name for outlier_station in found.outlier_stations] == ["Station 4"]
    assert verdict_on(found).grade == "fair"


def test_an_object_that_did_not_visibly_move_is_refused() -> None:
    station = thing_stations([0], CAMERA)[0]
    with pytest.raises(
        RefusalError, match="Nothing moved: all surfaces are at the same place in the 4 stations"
    ) as refusal:
        solved([station] * 4)
    assert "round about the axis" in refusal.value.advice


def test_the_table_alone_does_not_connect_two_stations() -> None:
    """More than half of the common surface is static."""
    first, second = solved(thing_stations([0, 2], CAMERA, seed=2), pictures=False).stations
    turn = Rotation.from_matrix(between(first.place, second.place).rotation)
    assert 0 < abs(np.degrees(turn.magnitude()) - 30) < 0.05


def test_two_stations_of_an_unturned_object_are_refused() -> None:
    with pytest.raises(RefusalError, match="Nothing was turned between the 2 stations") as refusal:
        solved(thing_stations([0, 0], CAMERA, seed=1))
    assert "4 or more" in refusal.value.advice


def test_a_calibration_of_another_rig_is_refused() -> None:
    stations = thing_stations([0, 1], CAMERA, seed=1, background=False)
    other = thing_stations([0], CAMERA, seed=3, background=False)[0].calibration
    with pytest.raises(RefusalError, match=r"Station 1: With this calibration, rays .* miss by 4\d projector pixels"):
        solved([replace(station, calibration=other) for station in stations])


def test_stations_without_overlap_are_refused() -> None:
    one = thing_stations([0], CAMERA, seed=2, background=False)
    other = thing_stations([0], CAMERA, seed=2, background=False, kind="box")
    with pytest.raises(RefusalError, match="No two stations show the same part of a thing"):
        solved([*one, *other])


@pytest.mark.parametrize(("kept", "what"), [(2000, "measure the thing"), (300, "measure anything")])
def test_a_thing_that_is_hardly_measured_is_not_said_to_be_turned_too_far(kept: int, what: str) -> None:
    """With all of their matches, the two stations fit together."""
    stations = thing_stations([0, 2], CAMERA, seed=2, background=False)
    dark = [
        replace(station, matches=station.matches[np.random.default_rng(0).permutation(len(station.matches))[:kept]])
        for station in stations
    ]
    with pytest.raises(RefusalError, match=f"Station 1, Station 2: only {kept} of its pixels {what}") as refusal:
        solved(dark)
    assert "expose longer" in refusal.value.advice
    assert "Turn the thing" not in refusal.value.advice


def test_the_result_is_written_and_exported(turned: tuple[list[ThingStation], SolvedObject], tmp_path: Path) -> None:
    import trimesh

    from scanner.exporting import FORMATS, ExportRequest
    from scanner.objects.save import save_object
    from scanner.results import read_joined

    _, found = turned
    surface, verdict = save_object(found, tmp_path, config_for(CAMERA), Terminal(quiet=True), fill=True)
    assert verdict.grade == "good"
    assert surface is not None
    assert surface.closed
    assert 0.2 < surface.bridged < 0.8  # a hundred and fifty degrees of it were seen
    assert surface.volume is None
    whole = read_joined(tmp_path)
    assert whole is not None
    assert len(whole.stations) == 5
    blue = (surface.mesh.colours == [90, 140, 255]).all(axis=1)
    assert 0.1 < np.count_nonzero(blue) / len(blue) < 0.8
    viewed = ViewedResult(tmp_path)
    assert viewed.names[0] == "The whole thing"
    shown = viewed.cloud("The whole thing")
    assert len(shown.rigs) == 5
    size = np.ptp(shown.points, axis=0).max() / found.calibration.baseline
    assert 0.3 < size < 3
    again = read_stations([tmp_path], config_for(CAMERA), Terminal(quiet=True))
    assert [len(each.matches) for each in again] == [len(station.decoded.matches) for station in found.stations]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for part in ("All 5 stations fit together as one object", 'class="points"', "of the surface bridges holes"):
        assert part in page
    for name in ("stl", "3mf"):
        out = tmp_path / f"thing.{name}"
        FORMATS[name].write(ExportRequest(tmp_path, out))
        if name == "stl":
            printed: Any = trimesh.load(out, process=True)
            assert printed.is_watertight
            assert printed.area == pytest.approx(1e6 * surface.area[0], rel=1e-3)


def test_the_surface_is_where_the_thing_is_and_ends_where_it_was_not_seen(
    turned: tuple[list[ThingStation], SolvedObject],
) -> None:
    o3d = open3d()
    stations, found = turned
    cloud = cloud_of(found)
    surface = surface_of(found, cloud, fill=False)
    assert surface is not None
    assert not surface.closed
    assert surface.bridged == 0
    to_solid = stations[0].place @ found.stations[0].place.inverse()
    points = to_solid @ (surface.mesh.points @ CAMERA_FROM_ROOM)
    solid, scene = stations[0].solid, o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(solid.vertices.astype(np.float32)), o3d.core.Tensor(solid.triangles.astype(np.uint32))
    )
    off = scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()
    assert 1e-6 < np.median(off) < 0.03 * cloud.grid
    assert np.percentile(off, 95) < 0.3 * cloud.grid
    assert off.max() < 3 * cloud.grid


def test_the_volume_of_a_closed_surface_is_reported() -> None:
    solid = thing_stations([0], CAMERA, seed=2, background=False)[0].solid
    assert is_closed(solid.triangles)
    assert not is_closed(solid.triangles[1:])
    assert volume_of(solid.vertices + 1.0, solid.triangles) == pytest.approx(solid.volume, rel=1e-9)
    assert area_of(solid.vertices, solid.triangles) == pytest.approx(solid.area, rel=1e-9)


@pytest.mark.parametrize(("percent", "grade"), [(0.3, "good"), (1.2, "fair")])
def test_a_rig_that_its_stations_hardly_calibrate_is_fair(
    turned: tuple[list[ThingStation], SolvedObject], percent: float, grade: str
) -> None:
    _, found = turned
    calibration = found.calibration
    camera, projector = (
        DeviceSigmas((device.focal_px[0] * percent / 100,) * 2)
        for device in (calibration.camera, calibration.projector)
    )
    weak = replace(calibration, sigma=Sigmas(camera, projector))
    by_scene = Finding(BY_SCENE, Severity.NOTE, "Calibrated without a corner.")
    verdict = verdict_on(replace(found, calibration=weak, findings=(by_scene,)))
    assert verdict.grade == grade
    assert ("± 1.2 %" in verdict.headline) == (grade == "fair")
    assert verdict_on(replace(found, calibration=weak)).grade == "good"  # given with those sigmas
