"""The rig from several corners, including a corner by another rig."""

import pytest

from scanner.capture import CaptureMetadata
from scanner.results import Decoded, GivenMatches
from scanner.rooms.corner_rig import corner_in, rig_of
from scanner.stations import read_stations
from scanner.ui import Terminal
from tests.scanner.rooms.conftest import SolvedExample
from tests.support.whole_room import with_turned_projector

_CORNERS = (0, 2)  # stations that look into one


@pytest.mark.parametrize("changed", _CORNERS)
def test_of_two_contradicting_corners_the_better_supported_one_is_used(example: SolvedExample, changed: int) -> None:
    captures = read_stations(example.files, example.config, Terminal(quiet=True))
    station = example.true[changed]
    rig = station.calibration
    matches = with_turned_projector(station, (0.2, 0.3, -0.4)).matches
    captures[changed] = Decoded(
        CaptureMetadata(rig.camera.size, rig.projector.size), matches, GivenMatches(), "changed"
    )
    corners = {k: corner_in(captures[k], example.config) for k in _CORNERS}
    start = rig_of(corners, captures)
    (kept,) = start.corners
    assert kept != changed
    assert start.calibration.camera.focal_px[0] == pytest.approx(rig.camera.focal_px[0], rel=0.03)
