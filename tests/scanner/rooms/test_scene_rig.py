"""The rig from several corners, including a corner by another rig.

What an operator is told between stations without a corner.
"""

import numpy as np
import pytest

from calib.geometry import rotation_about
from calib.scene import NextStation
from scanner.capture import CaptureMetadata
from scanner.results import Decoded, GivenMatches
from scanner.rooms.corner_rig import corner_in, rig_of
from scanner.rooms.scene_rig import _next, guide_without_corner
from scanner.stations import read_stations
from scanner.ui import Terminal
from tests.scanner.rooms.conftest import SolvedExample
from tests.support.things import config_for, decoded, thing_stations
from tests.support.whole_room import with_turned_projector

_CORNERS = (0, 2)  # stations that look into one
CAMERA = (612, 512)
QUIET = Terminal(quiet=True)


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


def test_first_stations_ask_for_more() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    stations = decoded(thing_stations([0, 1, 2], CAMERA, seed=1, steps=24), CAMERA, pictures=True)
    config = config_for(CAMERA)
    assert guide_without_corner(stations[:1], config, QUIET, "object").startswith("2 more stations calibrate the rig.")
    two = guide_without_corner(stations[:2], config, QUIET, "rig")
    assert two.startswith("One more station calibrates the rig. Next: move the rig")
    three = guide_without_corner(stations, config, QUIET, "object")
    assert "about one axis" in three
    assert "Tip the object once" in three


@pytest.mark.parametrize(
    ("axis", "point", "moves_to", "words"),
    [
        (0, [0.0, -1.0, 0.0], [0.0, 0.0, -1.0], "its top towards the camera"),
        (1, [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], "its front to the left"),
        (2, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], "clockwise as the camera sees it"),
    ],
)
def test_words_say_where_the_object_turns(axis: int, point: list[float], moves_to: list[float], words: str) -> None:
    turned = rotation_about(np.radians(20.0) * np.eye(3)[axis]) @ np.array(point)
    assert turned @ np.array(moves_to) == pytest.approx(np.sin(np.radians(20.0)))
    sentence = _next(NextStation(axis, 20.0, 0.001, 0.0015), "object")
    assert words in sentence
    assert "by 20°" in sentence
    assert sentence.endswith("then ± 0.15 %.")
    assert words not in _next(NextStation(axis, -20.0, 0.001, 0.0015), "object").replace("anticlockwise", "")
