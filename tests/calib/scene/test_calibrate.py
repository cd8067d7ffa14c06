"""Calibration without a corner: within its sigmas of the truth, or refused with what would help."""

import numpy as np
import pytest

from calib.geometry import Matches
from calib.numerics import Floats, Image
from calib.refusal import RefusalError
from calib.scene import SceneCalibration, calibrate_scene
from calib.scene.refusals import APART, NO_COMMON_POINTS, NOTHING_MOVED, ONE_AXIS, SLIDING, TOO_FEW_STATIONS
from calib.self_calibration import PrincipalPoint
from tests.support.things import PROJECTOR, ThingStation, thing_stations, true_rig, turned_stations

CAMERA, LARGER_CAMERA, SMALL_CAMERA = (459, 384), (612, 512), (306, 256)

pytestmark = pytest.mark.xdist_group("six sides")  # what they share is made once


def calibrated(captures: list[tuple[Matches, Image]], camera: tuple[int, int] = CAMERA) -> SceneCalibration:
    centre = PrincipalPoint(((camera[0] - 1) / 2, (camera[1] - 1) / 2), 0.03 * camera[0])
    return calibrate_scene(captures, camera, PROJECTOR, principal_point=centre)


def captures_of(stations: list[ThingStation]) -> list[tuple[Matches, Image]]:
    return [(station.matches, station.picture) for station in stations]


@pytest.fixture
def stations(six_sides: list[ThingStation]) -> list[ThingStation]:
    return six_sides


def in_sigmas(found: SceneCalibration, station: ThingStation) -> Floats:
    error = found.uncertainty.rig.step_to(true_rig(station.calibration))
    return np.asarray(error / np.sqrt(np.diag(found.uncertainty.covariance)), np.float64)


def test_six_sides_of_a_thing_calibrate_the_rig(stations: list[ThingStation], of_six_sides: SceneCalibration) -> None:
    found = of_six_sides
    assert found.stations == (0, 1, 2, 3, 4, 5)
    assert found.points > 100
    ratio = in_sigmas(found, stations[0])
    assert 0.3 < np.sqrt(np.mean(ratio**2)) < 2.0
    focal, sigma = found.calibration.camera.focal_px[0], found.calibration.sigma.camera.focal_px
    assert sigma is not None
    assert abs(focal / stations[0].calibration.camera.focal_px[0] - 1) < 0.01
    assert 2e-4 < sigma[0] / focal < 5e-3


def test_turns_about_one_axis_are_refused() -> None:
    with pytest.raises(RefusalError) as refusal:
        calibrated(captures_of(thing_stations([*range(4)], SMALL_CAMERA, steps=24)), SMALL_CAMERA)
    assert refusal.value.finding.kind == ONE_AXIS
    assert "Tip the object" in refusal.value.advice


def test_two_stations_are_too_few(stations: list[ThingStation]) -> None:
    with pytest.raises(RefusalError) as refusal:
        calibrated(captures_of(stations[:2]))
    assert refusal.value.finding.kind == TOO_FEW_STATIONS


def test_stations_at_one_place_are_refused(stations: list[ThingStation]) -> None:
    with pytest.raises(RefusalError) as refusal:
        calibrated(captures_of([stations[0]] * 3))
    assert refusal.value.finding.kind == NOTHING_MOVED


def without_pictures(stations: list[ThingStation]) -> list[tuple[Matches, Image]]:
    return [(station.matches, np.full_like(station.picture, 128)) for station in stations]


def test_a_shape_alone_calibrates_the_rig(stations: list[ThingStation]) -> None:
    found = calibrated(without_pictures(stations[:4]))
    assert found.stations == (0, 1, 2, 3)
    assert not found.problem.observations.is_located.any()
    assert 0.3 < np.sqrt(np.mean(in_sigmas(found, stations[0]) ** 2)) < 2.0
    focal, sigma = found.calibration.camera.focal_px[0], found.calibration.sigma.camera.focal_px
    assert sigma is not None
    assert 1e-6 < abs(focal / stations[0].calibration.camera.focal_px[0] - 1) < 0.01
    assert 2e-4 < sigma[0] / focal < 1e-2


@pytest.mark.parametrize("kind", ["ball", "vase"])
def test_shapes_that_fit_themselves_in_several_ways_are_refused(kind: str) -> None:
    with pytest.raises(RefusalError) as refusal:
        calibrated(without_pictures(turned_stations(3, SMALL_CAMERA, seed=1, kind=kind)), SMALL_CAMERA)
    assert refusal.value.finding.kind == SLIDING
    assert refusal.value.finding.data["captures"] == 3


def test_a_picture_of_another_size_is_named(stations: list[ThingStation]) -> None:
    matches, picture = captures_of(stations)[0]
    with pytest.raises(ValueError, match="the picture must have the shape"):
        calibrated([(matches, picture[:100])] * 3)


def test_three_of_five_stations_are_right_though_pictures_connect_no_more() -> None:
    """Few keypoints connect them, which a focal length shorter by a third explains nearly as well."""
    stations = thing_stations([0, 1, 2, 3, 4], LARGER_CAMERA, seed=1, steps=24, tip_deg=25.0)
    found = calibrated(captures_of(stations), LARGER_CAMERA)
    focal, sigma = found.calibration.camera.focal_px[0], found.calibration.sigma.camera.focal_px
    assert sigma is not None
    error = abs(focal / stations[0].calibration.camera.focal_px[0] - 1)
    assert 1e-6 < error < min(4 * sigma[0] / focal, 5e-3)


def test_a_zoom_that_moved_between_stations_is_refused(stations: list[ThingStation]) -> None:
    zoomed = []
    for number, station in enumerate(stations[:3]):
        pixels = station.matches.projector_px
        middle = (np.array(PROJECTOR) - 1) / 2
        larger = middle + (1 + 0.03 * number) * (pixels - middle)
        zoomed.append((Matches(station.matches.camera_px, larger, None, station.matches.sigma_px), station.picture))
    with pytest.raises(RefusalError) as refusal:
        calibrated(zoomed)
    assert refusal.value.finding.kind in (APART, NO_COMMON_POINTS)
