"""Drawn boards: each dot is at its place, to a fraction of a pixel."""

import cv2
import numpy as np
import pytest

from scanner.boards.printing import draw_target
from scanner.targets import Target


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
