"""Drawn boards: each dot is at its place, to a fraction of a pixel."""

import cv2
import numpy as np
import pytest

from scanner.boards.printing import draw_target
from scanner.targets import TAG_SPACING, Target


@pytest.mark.parametrize("kind", ["circles", "acircles"])
@pytest.mark.parametrize("side_px", [40, 80])
def test_dots_are_drawn_around_the_points_of_the_board(kind: str, side_px: int) -> None:
    target = Target(kind, 4, 5, 20.0)
    drawn = draw_target(target, side_px)
    count, _, _, rough = cv2.connectedComponentsWithStats((drawn.image < 128).astype(np.uint8))
    assert count == 1 + len(target.points)
    darkness = 255.0 - drawn.image
    reach = round(0.32 * side_px)
    found = []
    for x, y in np.rint(rough[1:]).astype(int).tolist():
        some = darkness[y - reach : y + reach + 1, x - reach : x + reach + 1]
        rows, columns = np.mgrid[y - reach : y + reach + 1, x - reach : x + reach + 1]
        found.append([np.sum(columns * some) / some.sum(), np.sum(rows * some) / some.sum()])
    middle = (target.points.min(axis=0) + target.points.max(axis=0)) / 2
    truth = (target.points - middle) / target.square * side_px + drawn.middle_px
    apart = np.linalg.norm(np.array(found)[:, None] - truth[None], axis=2).min(axis=1)
    assert apart.max() < 0.1


def test_tags_are_drawn_in_order_at_the_points_of_the_board() -> None:
    """OpenCV finds each by its number, and its corners at true distances."""
    target, side_px = Target("aprilgrid", 4, 3, 20.0), 40
    drawn = draw_target(target, side_px)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(drawn.image)
    assert sorted(numbers.ravel().tolist()) == list(range(12))
    step = round((1 + TAG_SPACING) * side_px)
    size_px = np.array([3, 2]) * step + side_px
    for number, found in zip(numbers.ravel().tolist(), corners, strict=True):
        row, column = divmod(number, 4)
        place = np.array([column, row]) * step + (side_px - size_px) / 2 + drawn.middle_px
        np.testing.assert_allclose(found[0].mean(axis=0), place, atol=1.0)
        assert np.ptp(found[0], axis=0) == pytest.approx([side_px - 1, side_px - 1], abs=1.5)
