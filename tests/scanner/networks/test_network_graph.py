"""Who sees whose light, drawn: what is said of each pair, and that it can be read."""

import re
from itertools import combinations
from xml.etree import ElementTree

import pytest

from scanner.networks.sights import PairProgress, network_graph

ALL = [
    PairProgress("left", "stage", 21, 21, 0.171),
    PairProgress("right", "stage", 21, 21, 0.684),
    PairProgress("left", "side", 21, 4),
    PairProgress("right", "side", failure="the cable is out"),
    PairProgress("third", "side"),
]


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
