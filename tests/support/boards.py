"""Synthetic boards, as views and as pictures."""

import cv2
import numpy as np

from calib.boards import BoardView
from calib.geometry import mapped
from calib.numerics import Floats
from calib.refinement import into_cells
from calib.synthetic import SyntheticBoards
from scanner.boards import draw_target
from scanner.targets import Target


def views_of(boards: SyntheticBoards) -> list[BoardView]:
    views = []
    for i, view in enumerate(boards.views):
        cells = into_cells(view.matches.with_faces(np.zeros(len(view.matches), np.int32)), (0,))
        views.append(BoardView(f"view {i}", view.points, view.corners_px, cells))
    return views


def photographed(target: Target, seed: int, size: tuple[int, int] = (800, 640)) -> tuple[np.ndarray, Floats]:
    """A flat board seen obliquely, blurred and noisy; and the pixels of its points, (N, 2)."""
    rng = np.random.default_rng(seed)
    side = 40
    drawn = draw_target(target, side)
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * target.reach
    angle = rng.uniform(-0.5, 0.5)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    place = half @ turn.T / target.reach * 0.33 * size[1] + np.array(size) / 2 + rng.uniform(-35, 35, (4, 2))
    homography = cv2.getPerspectiveTransform(half.astype(np.float32), place.astype(np.float32)).astype(np.float64)
    x, y = drawn.middle_px
    scale = target.square / side
    of_picture = np.array([[scale, 0, -scale * x], [0, scale, -scale * y], [0, 0, 1]])
    large = 3  # pixels average over what they see
    grown = np.array([[large, 0, (large - 1) / 2], [0, large, (large - 1) / 2], [0, 0, 1]])
    fine = cv2.warpPerspective(
        drawn.image, grown @ homography @ of_picture, (large * size[0], large * size[1]), borderValue=150
    )
    sharp = np.asarray(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), np.float64)
    picture = 0.7 * cv2.GaussianBlur(sharp, (0, 0), 0.7) + 30 + rng.normal(0, 1.5, sharp.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8), mapped(homography, target.points)
