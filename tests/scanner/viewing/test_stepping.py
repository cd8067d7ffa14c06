"""Steps from the page of a result.

Clouds shown with fewer points.
"""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.results import read_steps
from scanner.viewing.crop import box_within, frame_of
from scanner.viewing.decimation import many, shuffled, statement
from scanner.viewing.panel import keep_box, take_back
from scanner.viewing.result import ViewedResult
from tests.support.result_folder import write_captures


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stepping") / "two"
    write_captures(folder)
    return folder


@pytest.mark.parametrize("number", [0, 1, 2])
def test_the_viewers_box_becomes_a_step_in_the_axes_of_the_result(captures: Path, number: int) -> None:
    """Also of one of several captures, whose cloud is in its camera's frame."""
    result = ViewedResult(captures)
    name = result.names[number]
    cloud = result.cloud(name)
    frame = frame_of(cloud)
    ranges = np.stack([frame.low, frame.high], axis=1)
    ranges[0, 0] = 0.1
    box = box_within(frame, ranges)
    inside = box.holds(cloud.points)
    keep_box(result, name, cloud, box)
    try:
        kept = ViewedResult(captures).cloud(name)
        assert 1000 < len(kept.points) < 0.9 * len(cloud.points)
        assert np.array_equal(kept.points, cloud.points[inside])
    finally:
        take_back(result)
    assert read_steps(captures) == ()


@given(st.integers(0, 5000))
def test_the_order_is_a_fixed_permutation(count: int) -> None:
    order = shuffled(count)
    assert np.array_equal(np.sort(order), np.arange(count))
    assert np.array_equal(order, shuffled(count))


def test_every_prefix_is_evenly_spread() -> None:
    first = shuffled(1_000_000)[:10_000]
    per_tenth = np.bincount(first // 100_000, minlength=10)
    assert per_tenth.min() > 850
    assert per_tenth.max() < 1150


@pytest.mark.parametrize(
    ("shown", "total", "text"),
    [
        (612_500, 4_900_000, "showing 1 in 8 of 4.9 million points"),
        (500_000, 4_900_000, "showing 1 in 10 of 4.9 million points"),
        (500_000, 1_250_000, "showing 1 in 2.5 of 1.2 million points"),
        (13_024, 13_024, "showing all 13,024 points"),
        (0, 7, "showing none of 7 points"),
    ],
)
def test_the_decimation_is_stated(shown: int, total: int, text: str) -> None:
    assert statement(shown, total) == text


def test_more_points_than_all_is_an_error() -> None:
    with pytest.raises(ValueError, match="0 to 5"):
        statement(6, 5)


def test_large_numbers_are_formatted() -> None:
    assert (many(999_999), many(4_912_345)) == ("999,999", "4.9 million")
