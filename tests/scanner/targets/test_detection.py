"""Boards of each kind, drawn and photographed: detected at their places, counted, and refused otherwise."""

import numpy as np
import pytest

from scanner.errors import InputError
from scanner.targets.detection import NotFoundError, detect, on_board
from scanner.targets.target import Target, parse_target
from tests.support.board_captures import photographed


@pytest.mark.parametrize(
    ("kind", "columns", "rows", "most_px"),
    [
        ("chessboard", 9, 7, 0.06),
        ("charuco", 6, 8, 0.06),
        ("aprilgrid", 5, 4, 0.2),
        ("circles", 7, 5, 0.06),
        ("acircles", 4, 9, 0.06),
    ],
)
def test_points_are_detected_at_their_true_positions(kind: str, columns: int, rows: int, most_px: float) -> None:
    target = Target(kind, columns, rows, 20.0)
    picture, places = photographed(target, seed=3)
    found = detect(picture, target)
    assert len(found.points) == len(target.points)
    order = [int(np.argmin(np.linalg.norm(target.points - point, axis=1))) for point in found.points]
    # Two ways round, where the board looks the same.
    ways = [places[order], places[::-1][order]] if target.turns > 1 else [places[order]]
    rms = min(float(np.sqrt(np.mean((found.pixels - way) ** 2))) for way in ways)
    assert 1e-4 < rms < most_px


def test_the_board_mask_covers_the_points_only() -> None:
    target = Target("chessboard", 9, 7, 20.0)
    picture, places = photographed(target, seed=1)
    mask = on_board(detect(picture, target), target, (800, 640))
    column, row = np.rint(places).astype(int).T
    assert mask[row, column].all()
    assert 0.1 < mask.mean() < 0.5


def test_a_board_with_other_counts_is_reported() -> None:
    picture, _ = photographed(Target("chessboard", 9, 7, 20.0), seed=3)
    for columns, rows in ((7, 5), (8, 7)):
        with pytest.raises(NotFoundError, match=r"chessboard of (9 × 7|7 × 9) inner corners"):
            detect(picture, Target("chessboard", columns, rows, 20.0))


def test_two_boards_are_refused() -> None:
    target = Target("chessboard", 9, 7, 20.0)
    picture, _ = photographed(target, seed=3)
    with pytest.raises(NotFoundError, match="two boards"):
        detect(np.hstack([picture, picture]), target)


def test_a_missing_board_is_reported() -> None:
    with pytest.raises(NotFoundError, match="no circles:7x5 was found"):
        detect(np.full((300, 400), 90, np.uint8), Target("circles", 7, 5, 20.0))


def test_orientations_of_a_board() -> None:
    turns = {
        ("chessboard", 9, 7): 2,
        ("chessboard", 9, 6): 1,
        ("chessboard", 7, 7): 4,
        ("charuco", 6, 9): 1,
        ("circles", 7, 5): 2,
        ("circles", 6, 6): 4,
        ("acircles", 4, 11): 2,
    }
    for (kind, columns, rows), expected in turns.items():
        assert Target(kind, columns, rows, 1.0).turns == expected


@pytest.mark.parametrize("text", ["chessboard", "chessboard:9", "chessboard:9x0", "hexagons:3x4", "charuco:2x5"])
def test_impossible_boards_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--board"):
        parse_target(text, 10.0)
