"""Any cloud for the viewer in a page: thinned evenly, in whole numbers, with devices as outlines."""

import base64
import json

import numpy as np
import pytest

from calib.geometry import IDENTITY, Intrinsics
from scanner.reporting import CAMERA_COLOUR, Thinned, device_lines, looking, turning_view

AHEAD, UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])


def wall(across: int, spacing: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(across), np.arange(across))
    return np.stack([spacing * x.ravel(), spacing * y.ravel(), np.full(x.size, 2.0)], axis=1)


@pytest.mark.parametrize("across", [200, 500])
def test_squares_as_large_as_the_distance_of_points_close_the_surface(across: int) -> None:
    points = wall(across, 0.01)
    thinned = Thinned.of(points, np.zeros((len(points), 3), np.uint8), np.tile(-AHEAD, (len(points), 1)))
    assert thinned.total == len(points)
    assert len(thinned.points) == min(across**2, 70_000)
    spacing = 0.01 * np.sqrt(len(points) / len(thinned.points))
    assert 0.85 < thinned.grid / spacing < 1.15


def test_points_arrive_within_a_step_of_the_box() -> None:
    points = wall(30, 0.01)
    colours = np.arange(len(points) * 3, dtype=np.uint8).reshape(-1, 3)
    lines = device_lines(Intrinsics(640, 480, (500.0, 500.0), (320.0, 240.0)), IDENTITY, 0.5, CAMERA_COLOUR, "left")
    thinned = Thinned.of(points, colours, np.tile(-AHEAD, (len(points), 1)))
    view = turning_view(thinned, looking(AHEAD, UP, points), lines, "m")
    scene = json.loads(view.scene)
    records = np.frombuffer(base64.b64decode(view.points), [("at", "<u2", 3), ("rgb", "u1", 3), ("normal", "i1", 3)])
    assert (view.count, view.total, scene["count"]) == (900, 900, 900)
    places = np.array(scene["low"]) + np.array(scene["size"]) * records["at"] / 65_535
    assert np.abs(places - points).max() < 1e-5
    assert np.array_equal(records["rgb"], colours)
    assert np.array_equal(records["normal"][0], [0, 0, -127])
    assert scene["unit"] == [1000.0, "mm"]
    assert scene["centre"] == [0.145, 0.145, 2.0]
    assert [line["text"] for line in scene["lines"]] == ["left", "", "", "", ""]
    farthest = np.linalg.norm([line["at"][1] for line in scene["lines"][1:]], axis=1)
    assert np.allclose(farthest, 0.5, atol=1e-4)
