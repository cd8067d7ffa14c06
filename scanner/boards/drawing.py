"""Boards as pictures, to be printed."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from scanner.targets import TAG_SPACING, Target

Picture = NDArray[np.uint8]
_MARKER = 0.73  # side of a ChArUco board's marker, in squares
_DOT = 0.5  # diameter of a dot, in distances to its neighbour along a row
_OVER = 4  # dots are drawn this many times larger, for smooth edges
CHARUCO_DICTIONARY = cv2.aruco.DICT_5X5_1000


@dataclass(frozen=True)
class Drawn:
    """`image` (H, W), black on white, with `middle_px` (2,): where the middle of the board's points is in it."""

    image: Picture
    middle_px: tuple[float, float]


def draw_target(target: Target, side_px: int) -> Drawn:
    """A board whose squares (tags, distances) have this many pixels, with a white rim of about a square."""
    match target.kind:
        case "chessboard":
            inside = _checks(target.columns + 1, target.rows + 1, side_px)
        case "charuco":
            dictionary = cv2.aruco.getPredefinedDictionary(CHARUCO_DICTIONARY)
            board = cv2.aruco.CharucoBoard((target.columns, target.rows), 1.0, _MARKER, dictionary)
            size = (target.columns * side_px, target.rows * side_px)
            inside = np.asarray(board.generateImage(size, marginSize=0, borderBits=1), np.uint8)
        case "aprilgrid":
            inside = _tags(target, side_px)
        case _:
            inside = _dots(target, side_px)
    rim = side_px
    image = np.pad(inside, rim, constant_values=255)
    height, width = image.shape
    return Drawn(image, ((width - 1) / 2, (height - 1) / 2))


def _checks(columns: int, rows: int, side_px: int) -> Picture:
    row, column = np.indices((rows, columns))
    squares = np.where((row + column) % 2, 255, 0).astype(np.uint8)
    return np.kron(squares, np.ones((side_px, side_px), np.uint8))


def _tags(target: Target, side_px: int) -> Picture:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    step = round((1 + TAG_SPACING) * side_px)
    image = np.full(((target.rows - 1) * step + side_px, (target.columns - 1) * step + side_px), 255, np.uint8)
    for number in range(target.columns * target.rows):
        row, column = divmod(number, target.columns)
        tag = cv2.aruco.generateImageMarker(dictionary, number, side_px, borderBits=1)
        image[row * step : row * step + side_px, column * step : column * step + side_px] = tag
    return image


def _dots(target: Target, side_px: int) -> Picture:
    radius = _DOT * side_px / 2 * (0.7 if target.kind == "acircles" else 1.0)
    corner = target.points.min(axis=0) / target.square * side_px - radius
    size = -2 * corner
    width, height = (round(side) for side in size)
    large = np.full((_OVER * height, _OVER * width), 255, np.uint8)
    for point in target.points / target.square * side_px + size / 2:
        x, y = (_OVER * point - 0.5).tolist()
        cv2.circle(large, (round(x * 16), round(y * 16)), round(_OVER * radius * 16), 0, -1, cv2.LINE_AA, 4)
    return np.asarray(cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
