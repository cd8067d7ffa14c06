"""Detect a board's points in the camera's image with OpenCV's detectors."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from calib.geometry import homography_between, mapped
from calib.numerics import Bools, Floats, Image, Ints
from scanner.targets.grid_points import corrected, refined
from scanner.targets.target import Target

_SB = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
_FEWEST = 12  # points
# Lines of AprilTags meet at the corners without the bias of a blurred corner. In their pixels, corners are at whole
# numbers.
_APRILTAG_ORIGIN = 0.5
_NO_SQUARES = 0.7  # share of the usual contrast; between squares and a white rim there is half of it
_BESIDE_MARKERS = 0.35
_STRAY = 0.15  # distance in squares beyond which a point is not on the board
# Dictionaries of printed boards; a board's is found by trial.
_DICTIONARIES = (
    *("DICT_5X5_1000", "DICT_4X4_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL"),
    *("DICT_APRILTAG_36h11", "DICT_APRILTAG_25h9", "DICT_APRILTAG_16h5"),
)
_BLOB_SHARES = (2e-5, 2e-2)  # shares of the image's area


@dataclass(frozen=True)
class Detected:
    """Points (N, 2) of the board, from its middle, and where the camera saw them, (N, 2)."""

    points: Floats
    pixels: Floats


class NotFoundError(Exception):
    """The board is not in the image as required; the message gives the reason."""


def detect(image: Image, target: Target) -> Detected:
    """Find the one board in an image (H, W) or (H, W, 3), of 8 or 16 bits. Raises NotFoundError."""
    grey = _grey(image)
    detected = _find(grey, target)
    if detected is None:
        raise NotFoundError(f"no {target} was found{_what_else(grey, target)}")
    if _is_another(_without(grey, detected, target), target):
        raise NotFoundError(f"there are two boards like {target} in the picture; expected one")
    return detected


def on_board(detected: Detected, target: Target, size: tuple[int, int]) -> Bools:
    """The camera's pixels (H, W) on which the board is sure to be, for an image of (width, height)."""
    around = target.margin * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    reach = (detected.points[:, None] + around).reshape(-1, 2)
    hull = cv2.convexHull(reach.astype(np.float32)).reshape(-1, 2).astype(np.float64)
    outline = mapped(homography_between(detected.points, detected.pixels), hull)
    mask = np.zeros(size[::-1], np.uint8)
    cv2.fillConvexPoly(mask, np.rint(outline).astype(np.int32), 1)
    return mask.astype(np.bool_)


def _find(grey: Image, target: Target) -> Detected | None:
    match target.kind:
        case "chessboard":
            detected = _chessboard(grey, target)
        case "charuco":
            detected = _charuco(grey, target)
        case "aprilgrid":
            detected = _aprilgrid(grey, target)
        case _:
            detected = _dots(grey, target)
    detected = None if detected is None else _consistent(detected, target)
    if detected is None or target.kind not in ("chessboard", "charuco"):
        return detected
    # Chessboard corners between markers belong to a ChArUco board.
    free = target.square * (_BESIDE_MARKERS if target.kind == "charuco" else 1.0)
    return Detected(detected.points, refined(grey, detected.points, detected.pixels, free))


def _is_another(grey: Image, target: Target) -> bool:
    """Whether the rest shows a second board: a quick search for one as visible as the first."""
    counts = (target.columns, target.rows)
    if target.kind == "chessboard":
        small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        return any(bool(cv2.findChessboardCornersSB(picture, counts, flags=0)[0]) for picture in (small, grey))
    if target.kind == "charuco":
        return _charuco(grey, target) is not None
    return False


def _consistent(detected: Detected, target: Target) -> Detected | None:
    """Without points that are not where the others put them; None if too few are left."""
    for _ in range(2):
        if len(detected.points) < max(min(_FEWEST, len(target.points)), 4):
            return None
        homography = homography_between(detected.pixels, detected.points)
        off = np.linalg.norm(mapped(homography, detected.pixels) - detected.points, axis=1)
        near = off < _STRAY * target.square
        detected = Detected(detected.points[near], detected.pixels[near])
    return detected


def _chessboard(grey: Image, target: Target) -> Detected | None:
    """Raises NotFoundError for a larger board, of which a different part could be taken in each picture."""
    counts = (target.columns, target.rows)
    for picture in (grey, _equalised(grey)):
        grid = _largest(picture, counts)
        if grid is not None and grid.shape[:2] in (counts[::-1], counts):
            ordered = grid if grid.shape[:2] == counts[::-1] else grid.transpose(1, 0, 2)
            return _right_way_round(ordered.reshape(-1, 2), target)
        if grid is not None:
            raise NotFoundError(f"no {target} was found, but {_counted(grid)}")
    is_found, corners = cv2.findChessboardCorners(grey, counts)
    return _right_way_round(_pixels(corners), target) if is_found else None


def _largest(grey: Image, counts: tuple[int, int]) -> Floats | None:
    """The corners (R, C, 2) of a chessboard with at least these counts; None if there is none."""
    is_found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, counts, _SB | cv2.CALIB_CB_LARGER)
    if not is_found:
        return None
    grid = _pixels(corners).reshape(*meta.shape[:2], 2)
    # The rim of the sheet may look like another row of corners, but has no squares on either side.
    contrast = _contrast(grey, grid)
    usual = float(np.median(contrast))
    while (odd := _odd_side(contrast, usual)) is not None:
        grid, contrast = grid[odd], contrast[odd]
    return grid


def _contrast(grey: Image, grid: Floats) -> Floats:
    """Return the brightness of two opposite squares at each corner minus that of the other two, (R, C)."""
    rows, columns = grid.shape[:2]
    column, row = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))
    places = np.stack([column.ravel(), row.ravel()], axis=1)
    homography = homography_between(places, grid.reshape(-1, 2))
    levels = []
    for aside in ((-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3)):
        x, y = np.rint(mapped(homography, places + np.array(aside))).astype(np.int64).T
        levels.append(grey[y.clip(0, grey.shape[0] - 1), x.clip(0, grey.shape[1] - 1)].astype(np.float64))
    contrast: Floats = np.abs(levels[0] + levels[2] - levels[1] - levels[3]).reshape(rows, columns)
    return contrast


def _odd_side(contrast: Floats, usual: float) -> tuple[slice, slice] | None:
    """What is left without the first of the four sides on which there are no squares; None if there is no such side."""
    every = slice(None)
    for side, rest in (
        (contrast[0], (slice(1, None), every)),
        (contrast[-1], (slice(None, -1), every)),
        (contrast[:, 0], (every, slice(1, None))),
        (contrast[:, -1], (every, slice(None, -1))),
    ):
        if np.median(side) < _NO_SQUARES * usual and min(contrast.shape) > 2:
            return rest
    return None


def _counted(grid: Floats) -> str:
    return f"a chessboard of {max(grid.shape[:2])} × {min(grid.shape[:2])} inner corners"


def _right_way_round(pixels: Floats, target: Target) -> Detected:
    """Rows from left to right as seen from the front: a detector may begin at any corner."""
    grid = pixels.reshape(target.rows, target.columns, 2)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0:
        # An asymmetric grid of odd rows that was found from the other end is shifted alike there.
        grid = grid[::-1] if target.kind == "acircles" and target.rows % 2 else grid[:, ::-1]
    return Detected(target.points, grid.reshape(-1, 2))


def _charuco(grey: Image, target: Target) -> Detected | None:
    best: Detected | None = None
    for name in _DICTIONARIES:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        if len(dictionary.bytesList) < target.columns * target.rows // 2:
            continue
        for legacy in (False, True):
            board = cv2.aruco.CharucoBoard((target.columns, target.rows), 1.0, 0.75, dictionary)
            board.setLegacyPattern(legacy)
            corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
            numbers = np.asarray(ids if ids is not None else [], np.int64).ravel()
            detected = Detected(target.points[numbers], _pixels(corners if len(numbers) else []))
            checked = _consistent(detected, target)
            if checked is not None and (best is None or len(checked.points) > len(best.points)):
                best = checked
        if best is not None and len(best.points) > len(target.points) // 2:
            break
    return best


def _aprilgrid(grey: Image, target: Target) -> Detected | None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    best: Detected | None = None
    for border in (2, 1):  # Kalibr's tags have a border of two modules, OpenCV's of one
        parameters.markerBorderBits = border
        corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
        if ids is None or not len(corners):
            continue
        numbers = np.asarray(ids, np.int64).ravel()
        there = numbers < target.columns * target.rows
        pixels = np.concatenate([_pixels(corner) for corner in corners]).reshape(-1, 4, 2)[there].reshape(-1, 2)
        pixels = pixels - _APRILTAG_ORIGIN
        for places in _tag_numberings(numbers[there], target):
            chosen = (4 * places[:, None] + np.arange(4)).ravel()
            checked = _consistent(Detected(target.points[chosen], pixels), target) if len(places) >= 3 else None
            if checked is not None and (best is None or len(checked.points) > len(best.points)):
                best = checked
    return best


def _tag_numberings(numbers: Ints, target: Target) -> Iterator[Ints]:
    """Which place, row by row from the top, tags have: OpenCV counts from the top row, Kalibr from the bottom one."""
    yield numbers
    row, column = np.divmod(numbers, target.columns)
    yield (target.rows - 1 - row) * target.columns + column


def _dots(grey: Image, target: Target) -> Detected | None:
    symmetric = cv2.CALIB_CB_SYMMETRIC_GRID if target.kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
    counts = (target.columns, target.rows)
    for picture in (grey, 255 - grey, _equalised(grey), 255 - _equalised(grey)):
        for flags in (symmetric, symmetric | cv2.CALIB_CB_CLUSTERING):
            is_found, centres = cv2.findCirclesGrid(picture, counts, flags=flags, blobDetector=_blobs(grey))
            if is_found:
                ordered = _right_way_round(_pixels(centres), target)
                return Detected(ordered.points, corrected(grey, ordered.points, ordered.pixels))
    return None


def _blobs(grey: Image) -> cv2.SimpleBlobDetector:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea, parameters.maxArea = (max(share * grey.size, 10.0) for share in _BLOB_SHARES)
    parameters.minDistBetweenBlobs = 3
    return cv2.SimpleBlobDetector.create(parameters)


def _what_else(grey: Image, target: Target) -> str:
    """Describe what the picture shows instead, as far as can be determined."""
    if target.kind == "chessboard":
        fewer = (max(3, target.columns - 3), max(3, target.rows - 3))
        for counts in (fewer, fewer[::-1]):
            grid = _largest(grey, counts)
            if grid is not None:
                return f", but {_counted(grid)}"
    if target.kind in ("charuco", "aprilgrid"):
        highest = max(_markers(grey), default=0)
        return f", but {highest} markers of such a board" if highest else ", nor any markers"
    return ": it must be lit, completely in the picture, and have these counts"


def _markers(grey: Image) -> Iterator[int]:
    for name in _DICTIONARIES:
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)))
        _, ids, _ = detector.detectMarkers(grey)
        yield 0 if ids is None else len(ids)


def _without(grey: Image, detected: Detected, target: Target) -> Image:
    """The image with the board painted over."""
    painted = grey.copy()
    mask = on_board(detected, target, (grey.shape[1], grey.shape[0]))
    painted[mask] = np.median(grey[mask])
    return painted


def _grey(image: Image) -> Image:
    """8 bits, from black to the brightest there is."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    if grey.dtype == np.uint8 and grey.max() > 127:
        return np.ascontiguousarray(grey, np.uint8)
    top = max(float(np.percentile(grey, 99.9)), 1.0)
    return np.asarray(np.clip(grey.astype(np.float32) * (255.0 / top), 0, 255), np.uint8)


def _equalised(grey: Image) -> Image:
    return np.asarray(cv2.createCLAHE(3.0, (8, 8)).apply(grey), np.uint8)


def _pixels(corners: object) -> Floats:
    return np.asarray(corners, np.float64).reshape(-1, 2)
