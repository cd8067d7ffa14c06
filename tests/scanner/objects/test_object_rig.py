"""A rig's calibration from the stations of a thing, which pictures connect in part and surfaces whole."""

import numpy as np
import pytest

from calib.geometry import Matches
from calib.numerics import Floats
from calib.refinement import State
from calib.refusal import RefusalError
from calib.scene import BY_SCENE, ONE_AXIS, TOO_FEW_STATIONS, calibrate_scene
from calib.self_calibration import PrincipalPoint
from scanner.objects.object_rig import calibrate_without_corner, rig_from_object
from scanner.results import Decoded
from scanner.stations import RigStart
from scanner.ui import Terminal
from tests.support.things import PROJECTOR, config_for, decoded, thing_stations, true_rig

CAMERA = (459, 384)
NO_CORNER = RefusalError(TOO_FEW_STATIONS, "No three planes are perpendicular.", "Find a corner.")


@pytest.fixture(scope="module")
def captures() -> tuple[list[Decoded], State]:
    """Five steps of a turntable, of which one is tipped, and the true rig."""
    pytest.importorskip("open3d", exc_type=ImportError)
    stations = thing_stations([0, 1, 2, 3, 4], CAMERA, seed=4, steps=24, tip_deg=25.0)
    return decoded(stations, CAMERA, pictures=True), true_rig(stations[0].calibration)


def in_sigmas(start: RigStart, truth: State) -> Floats:
    assert start.uncertainty is not None
    error = start.uncertainty.rig.step_to(truth)
    return np.asarray(error / np.sqrt(np.diag(start.uncertainty.covariance)), np.float64)


def test_surfaces_join_what_pictures_do_not(captures: tuple[list[Decoded], State]) -> None:
    stations, truth = captures
    start = rig_from_object(stations, config_for(CAMERA), Terminal(quiet=True))
    (finding,) = start.findings
    assert finding.kind == BY_SCENE
    assert finding.data["captures"] == 5
    percent = finding.data["camera_focal_percent"]
    assert isinstance(percent, float)
    assert 0.01 < percent < 0.4
    assert 0.2 < np.sqrt(np.mean(in_sigmas(start, truth) ** 2)) < 2.0


def test_one_axis_is_refused_after_all_stations_are_placed() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    stations = decoded(thing_stations([0, 1, 2, 3], CAMERA, seed=1, steps=24), CAMERA, pictures=True)
    with pytest.raises(RefusalError) as refusal:
        calibrate_without_corner(stations, config_for(CAMERA), Terminal(quiet=True), NO_CORNER)
    assert refusal.value.finding.kind == ONE_AXIS
    assert refusal.value.reason.startswith("No three planes are perpendicular. Without a corner: All rotations")


def test_two_captures_are_refused_for_their_lack_of_a_corner(captures: tuple[list[Decoded], State]) -> None:
    with pytest.raises(RefusalError) as refusal:
        calibrate_without_corner(captures[0][:2], config_for(CAMERA), Terminal(quiet=True), NO_CORNER)
    assert refusal.value is NO_CORNER


def test_a_provisional_calibration_is_one_that_would_be_refused() -> None:
    """The last station is from behind, so that pictures do not connect it."""
    stations = thing_stations([0, 1, 2, 3, 12], CAMERA, seed=1, steps=24)
    captures = [(Matches(s.matches.camera_px, s.matches.projector_px), s.picture) for s in stations]
    centre = PrincipalPoint(((CAMERA[0] - 1) / 2, (CAMERA[1] - 1) / 2), 0.03 * CAMERA[0])
    found = calibrate_scene(captures, CAMERA, PROJECTOR, principal_point=centre, provisional=True)
    assert found.stations == (0, 1, 2, 3)
    assert found.leaves_open is not None
    assert found.leaves_open.finding.kind == ONE_AXIS
    truth = stations[0].calibration.camera.focal_px[0]
    assert 1e-6 < abs(found.calibration.camera.focal_px[0] / truth - 1) < 0.1
