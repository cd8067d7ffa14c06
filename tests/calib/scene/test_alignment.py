"""Points that stations of a known scene share, aligned in their pictures."""

import numpy as np
import pytest

from calib.geometry import Pose
from calib.numerics import Floats
from calib.scene.alignment import align
from calib.scene.rigid_scene import RigidScene, SceneObservations
from calib.scene.views import MatchedView, quadratic_maps, views_of
from tests.support.things import ThingStation, cluttered_stations, true_rig

CAMERA_SIZE = (612, 512)
HALF_WINDOW = 7  # pixels around a corner that are compared


@pytest.fixture(scope="module")
def stations() -> list[ThingStation]:
    """Two places about bodies that hide each other in part."""
    return cluttered_stations(2, CAMERA_SIZE, seed=7)


@pytest.fixture(scope="module")
def views(stations: list[ThingStation]) -> list[MatchedView]:
    return views_of([(station.matches, station.picture) for station in stations], CAMERA_SIZE)[0]


@pytest.fixture(scope="module")
def motion(stations: list[ThingStation]) -> Pose:
    """X_second = R X_first + t, in baselines."""
    first, second = stations
    motion = second.place.inverse() @ first.place
    return Pose(motion.rotation, motion.translation / first.calibration.baseline)


@pytest.fixture(scope="module")
def found(stations: list[ThingStation], views: list[MatchedView], motion: Pose) -> tuple[SceneObservations, Floats]:
    poses = (Pose(np.eye(3), np.zeros(3)), motion)
    return align(RigidScene(true_rig(stations[0].calibration), poses, np.zeros((0, 3))), views)


def test_corners_are_where_the_scene_puts_them(
    found: tuple[SceneObservations, Floats], stations: list[ThingStation], motion: Pose
) -> None:
    """To a fifth of a pixel or better, and not exactly: pictures and matches are noisy."""
    observations, points = found
    second = observations.is_located & (observations.station == 1)
    camera = stations[0].calibration.camera
    places = motion @ points[observations.point[second]]
    off = camera.project(places) - observations.camera_px[second]
    rms = float(np.sqrt(np.mean(off**2)))
    assert np.count_nonzero(second) > 50
    assert 0.01 < rms < 0.2
    assert np.abs(np.median(off, axis=0)).max() < 0.03


def test_nothing_is_aligned_over_an_edge(found: tuple[SceneObservations, Floats], views: list[MatchedView]) -> None:
    observations, _ = found
    for number, view in enumerate(views):
        located = observations.is_located & (observations.station == number)
        _, rms, sigma = quadratic_maps(view.places, observations.camera_px[located], HALF_WINDOW)
        assert np.max(rms / sigma) < 4
