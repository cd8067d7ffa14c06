"""A board as a picture, and as a PDF of true size with a ruler that shows whether the printer kept it."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from scanner.errors import InputError
from scanner.targets import CHARUCO_A4, KINDS, TAG_SPACING, UNIT, Target, parse_target

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


SHEETS_MM = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "LETTER": (215.9, 279.4)}
_DPI = 600
_MM_PER_INCH = 25.4
_EDGE_MM, _RULER_MM, _FOOT_MM = 5.0, 150, 14.0
_A4_SQUARE_MM = 30.0


def printed_target(text: str, square: float | None) -> tuple[Target, str]:
    """'charuco:A4', or 'chessboard:9x7@A3' with a square → the board and its sheet. Raises InputError."""
    kind, _, rest = text.partition(":")
    if rest.upper() in SHEETS_MM and kind == "charuco":
        return Target(kind, *CHARUCO_A4, _A4_SQUARE_MM if square is None else square), rest.upper()
    counts, _, sheet = rest.partition("@")
    sheet = sheet.upper() or "A4"
    if kind not in KINDS or sheet not in SHEETS_MM:
        raise InputError(f"--print {text}: expected charuco:A4, or a board and a sheet, as in chessboard:9x7@A4")
    if square is None:
        raise InputError(f"--print {text}: expected --square, as in 25mm")
    return parse_target(f"{kind}:{counts}", square), sheet


def write_pdf(path: Path, target: Target, sheet: str) -> None:
    """Write the board as one page. Raises InputError if the board does not fit the sheet, OSError."""
    per_mm = _DPI / _MM_PER_INCH
    side_px = round(target.square * per_mm)
    board = draw_target(target, side_px).image[side_px:-side_px, side_px:-side_px]
    # A square is a whole number of dots, so the page states the resolution that gives the true size.
    dpi = side_px / target.square * _MM_PER_INCH
    page = _page(board, SHEETS_MM[sheet], dpi / _MM_PER_INCH)
    if page is None:
        width, height = (side / per_mm for side in board.shape[::-1])
        raise InputError(
            f"--print: a {target} with squares of {target.square:g} {UNIT} takes {width:.0f} × {height:.0f} mm, which "
            f"is more than {sheet} leaves; choose a smaller --square, or another sheet"
        )
    _caption(page, target, sheet, dpi / _MM_PER_INCH)
    page.convert("1", dither=Image.Dither.NONE).save(path, "PDF", resolution=dpi, title=f"{target}")


def _page(board: Picture, sheet_mm: tuple[float, float], per_mm: float) -> Image.Image | None:
    """The sheet, portrait or landscape, with the board centred above the ruler."""
    for width, height in (sheet_mm, sheet_mm[::-1]):
        free = np.array([width - 2 * _EDGE_MM, height - 2 * _EDGE_MM - _FOOT_MM]) * per_mm
        if np.all(np.array(board.shape[::-1]) <= free):
            page = Image.new("L", (round(width * per_mm), round(height * per_mm)), 255)
            left, top = (_EDGE_MM * per_mm + (free - board.shape[::-1]) / 2).astype(int)
            page.paste(Image.fromarray(board), (int(left), int(top)))
            return page
    return None


def _caption(page: Image.Image, target: Target, sheet: str, per_mm: float) -> None:
    """A ruler along the lower edge, and the name of the board."""
    draw, bottom = ImageDraw.Draw(page), page.height - _EDGE_MM * per_mm
    font = ImageFont.load_default(2.6 * per_mm)
    margin, line = 2 * _EDGE_MM * per_mm, max(1, round(0.1 * per_mm))
    for mm in range(_RULER_MM + 1):
        length = 4.0 if mm % 10 == 0 else 3.0 if mm % 5 == 0 else 2.0
        x = margin + mm * per_mm
        draw.line((x, bottom, x, bottom - length * per_mm), 0, line)
        if mm % 50 == 0:
            draw.text((x, bottom - 4.2 * per_mm), f"{mm}", 0, font, "ms")
    caption = f"{target}, {target.square:g} mm, {sheet}: print at 100 %. This ruler is {_RULER_MM} mm long: measure it."
    draw.text((margin, bottom - 8.0 * per_mm), caption, 0, font, "ls")
