"""Steps from the page of a result."""

from pathlib import Path

import numpy as np
import pytest

from scanner.results import read_steps
from scanner.viewing.crop import box_within, frame_of
from scanner.viewing.result import ViewedResult
from scanner.viewing.stepping import keep_box, take_back
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
