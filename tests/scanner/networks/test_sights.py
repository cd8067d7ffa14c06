"""What is told of captures while they are taken."""

from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Matches, Size
from hw.rig import Frame
from scanner.capture import CaptureMetadata
from scanner.networks.sights import PairProgress, Watched, frames_in
from scanner.patterns import Black, White, pattern_to_dict
from scanner.results import Decoded, GivenMatches, kept_text
from scanner.ui import Terminal
from tests.support.small_capture import PATTERNS, read_listing, write_capture, write_listing

PAIRS = [("left", "stage"), ("right", "stage")]


def frame(level: int) -> Frame:
    return Frame(np.full((2, 3), level, np.uint8))


def test_each_camera_captured_together_has_its_own_progress() -> None:
    seen: list[tuple[PairProgress, int]] = []
    items = [((White(), frame(10 + number)), (White(), frame(20 + number))) for number in range(2)]

    watched = Watched(PAIRS, Terminal(quiet=True), lambda sight, taken: seen.append((sight, _level(taken))))
    assert [*watched.track(items, 3, "Capturing")] == items
    watched.decoded(PAIRS[0], decoded(240))
    error = OSError("unplugged")
    watched.__exit__(OSError, error, None)

    assert error.__notes__ == ["This was left and right in the light of stage."]
    assert [(sight.camera, sight.text, level) for sight, level in seen] == [
        ("left", "1 of 3 frames", 10),
        ("right", "1 of 3 frames", 20),
        ("left", "2 of 3 frames", 11),
        ("right", "2 of 3 frames", 21),
        ("left", "25.0 % of its picture", -1),
        ("right", "failed: unplugged", -1),
    ]


def _level(taken: Frame | None) -> int:
    return -1 if taken is None else int(taken.image[0, 0])


def decoded(count: int) -> Decoded:
    """Of a camera of 40 × 24 pixels."""
    points = np.zeros((count, 2))
    metadata = CaptureMetadata(Size(40, 24), Size(40, 24), (White(), Black()))
    return Decoded(metadata, Matches(points, points), GivenMatches(np.zeros((24, 40), np.uint8)))


@pytest.mark.parametrize(("item", "count"), [((White(), frame(1)), 1), (((White(), frame(1)),) * 3, 3), ("row", 0)])
def test_frames_in_stream_items_are_counted(item: object, count: int) -> None:
    assert len(frames_in(item)) == count


def test_kept_network_captures_name_the_command_that_takes_them(tmp_path: Path) -> None:
    kept = tmp_path / "hall-incomplete"
    for pair, count in (("left-side", len(PATTERNS)), ("left-stage", len(PATTERNS)), ("right-stage", 7)):
        folder = write_capture(kept / "captures" / pair / "capture", PATTERNS[:count])
        sequence = {"sequence": [pattern_to_dict(each) for each in PATTERNS]}
        write_listing(folder, read_listing(folder) | sequence)
    told = f"What was captured so far is kept in {kept / 'captures'}: 2 of 3 captures are whole, "
    assert kept_text(kept) == f"{told}and scan network takes those."
