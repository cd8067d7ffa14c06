"""What is told of captures while they are taken.

Who sees whose light, drawn: what is said of each pair, and that it can be read.
"""

import re
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from calib.geometry import Matches, Size
from hw.rig import Frame
from scanner.capture import CaptureMetadata
from scanner.networks.sights import PairProgress, Watched, frames_in, network_graph
from scanner.patterns import Black, White, pattern_to_dict
from scanner.results import Decoded, GivenMatches, kept_text
from scanner.ui import Terminal
from tests.support.small_capture import PATTERNS, read_listing, write_capture, write_listing

PAIRS = [("left", "stage"), ("right", "stage")]
ALL = [
    PairProgress("left", "stage", 21, 21, 0.171),
    PairProgress("right", "stage", 21, 21, 0.684),
    PairProgress("left", "side", 21, 4),
    PairProgress("right", "side", failure="the cable is out"),
    PairProgress("third", "side"),
]


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


def drawn(sights: list[PairProgress]) -> ElementTree.Element:
    return ElementTree.fromstring(str(network_graph(sights)))


def test_each_pair_shows_its_state_with_a_text_alternative() -> None:
    svg = drawn(ALL)

    assert [text.text for text in svg.iter("text")] == [
        *("17.1 %", "68.4 %", "4/21", "✕", "…"),
        *("left", "right", "third", "stage", "side"),
    ]
    sentences = [title.text for title in svg.iter("title")]
    assert sentences == [
        "left in the light of stage: 17.1 % of its picture",
        "right in the light of stage: 68.4 % of its picture",
        "left in the light of side: 4 of 21 frames",
        "right in the light of side: failed: the cable is out",
        "third in the light of side: waiting",
    ]
    assert svg.get("role") == "img"
    assert svg.get("aria-label") == ". ".join(filter(None, sentences))
    narrow, wide, *unknown = svg.iter("line")
    assert float(wide.get("stroke-width", 0)) > 2 * float(narrow.get("stroke-width", 0)) > 4
    assert all(line.get("stroke-dasharray") for line in unknown)


@pytest.mark.parametrize(("cameras", "projectors"), [(1, 2), (2, 1), (2, 2), (4, 4), (8, 2), (2, 8)])
def test_no_label_lies_on_another_and_none_on_a_name(cameras: int, projectors: int) -> None:
    svg = drawn(
        [
            PairProgress(f"camera_{i}", f"projector_{j}", 21, 21, 0.987)
            for j in range(projectors)
            for i in range(cameras)
        ]
    )
    boxes = [tuple(float(box.get(key, 0)) for key in ("x", "y", "width", "height")) for box in svg.iter("rect")]
    assert len(boxes) == cameras * projectors
    for (x, y, width, height), (other_x, other_y, _, _) in combinations(boxes, 2):
        assert abs(x - other_x) >= width or abs(y - other_y) >= height
    left, right = (float(dot) for dot in sorted({circle.get("cx", "") for circle in svg.iter("circle")}, key=float))
    assert all(left <= x and x + width <= right for x, _, width, _ in boxes)


def test_a_folder_may_have_any_name() -> None:
    svg = drawn([PairProgress('<b>&"', "a_projector_with_a_long_name", 1, 1, 1.0)])
    assert [text.text for text in svg.iter("text")] == ["100.0 %", '<b>&"', "a_projector_w…"]
    assert not re.search("<b>", str(network_graph([PairProgress("<b>", "p")])))
