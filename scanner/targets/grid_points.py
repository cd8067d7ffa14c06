"""Points of printed boards: the saddle points of a chessboard's brightness, and the centres of dots.

Corners are refined to a few hundredths of a pixel (L. Lucchese and S. Mitra, Using saddle points for subpixel feature
detection in camera calibration targets, APCCAS 2002). OpenCV's sector-based detector scales small squares up, and then
its grid is some tenths of a per cent too large.

The centre of a dot's image is not the image of its centre (J. Heikkilä, Geometric camera calibration using circular
control points, PAMI 22, 2000). Both centres are computed here from the board's homography and the measured radius of
the dots, and the difference is subtracted.
"""

from functools import cache

import cv2
import numpy as np

from calib.geometry import homography_between, mapped
from calib.numerics import Floats, Image

_RIM = 48  # samples around a dot
_STEP = 1e-3  # of the dots' distance
_DOT_WINDOW = 0.45  # half a window around a dot, in distances to its neighbour
_BLUR, _SADDLE_WINDOW = 0.08, 0.08  # standard deviations, in squares
_LEAST_BLUR_PX, _LEAST_WINDOW_PX = 0.8, 1.0
_REACH = 1.5  # in standard deviations of the window
_STEPS = 8
_FARTHEST = 0.2  # largest distance in squares from the detected position


def corrected(grey: Image, points: Floats, pixels: Floats) -> Floats:
    """Return the images of the dots' centres, pixels (N, 2), from the centres of the dots' images, (N, 2)."""
    spacing = _spacing(points)
    homography = homography_between(points, pixels)
    radius = _radius(grey, points, pixels, homography, spacing)
    angle = np.linspace(0, 2 * np.pi, _RIM, endpoint=False)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for _ in range(2):
        outlines = mapped(homography, (points[:, None] + rim).reshape(-1, 2)).reshape(len(points), _RIM, 2)
        better = pixels - (_centroids(outlines) - mapped(homography, points))
        homography = homography_between(points, better)
    return better


def _spacing(points: Floats) -> float:
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    return float(np.min(distances[distances > 0]))


def _radius(grey: Image, points: Floats, pixels: Floats, homography: Floats, spacing: float) -> float:
    """Return the radius of the dots, in the unit of the points, from the median of their areas."""
    step = _STEP * spacing
    along, down = (mapped(homography, points + step * axis) - mapped(homography, points) for axis in np.eye(2))
    per_unit = np.abs(along[:, 0] * down[:, 1] - along[:, 1] * down[:, 0]) / step**2
    radii = []
    for (x, y), scale in zip(pixels, per_unit, strict=True):
        half = max(2, int(_DOT_WINDOW * spacing * np.sqrt(scale)))
        column, row = round(float(x)), round(float(y))
        window = grey[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
        _, binary = cv2.threshold(window, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        middle = binary[min(half, row), min(half, column)] if binary.size else 0
        _, labels = cv2.connectedComponents((binary == middle).astype(np.uint8))
        area = np.count_nonzero(labels == labels[min(half, row), min(half, column)])
        radii.append(np.sqrt(area / (np.pi * scale)))
    return float(np.clip(np.median(radii), 0.0, _DOT_WINDOW * spacing))


def _centroids(outlines: Floats) -> Floats:
    """Return the centroids (N, 2) of polygons (N, K, 2)."""
    following = np.roll(outlines, -1, axis=1)
    cross = outlines[..., 0] * following[..., 1] - outlines[..., 1] * following[..., 0]
    total = np.sum((outlines + following) * cross[..., None], axis=1)
    centroids: Floats = total / (3 * np.sum(cross, axis=1))[:, None]
    return centroids


def refined(grey: Image, points: Floats, pixels: Floats, square: float) -> Floats:
    """Refine the pixels (N, 2) of a board's corners `points` (N, 2); those that are no saddles are unchanged.

    `square`: radius around a corner that contains only its four squares.
    """
    side = _sides(points, pixels, square)
    blur = max(_LEAST_BLUR_PX, _BLUR * float(np.median(side)))
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), blur)
    return np.stack([_saddle(smooth, pixel, pixel_side) for pixel, pixel_side in zip(pixels, side, strict=True)])


def _sides(points: Floats, pixels: Floats, square: float) -> Floats:
    """Return the length of the shorter side of a square at each corner, in px, (N,)."""
    homography = homography_between(points, pixels)
    here = mapped(homography, points)
    both = [np.linalg.norm(mapped(homography, points + square * axis) - here, axis=1) for axis in np.eye(2)]
    sides: Floats = np.minimum(*both)
    return sides


def _saddle(smooth: Image | np.ndarray, start: Floats, side: float) -> Floats:
    window = max(_LEAST_WINDOW_PX, _SADDLE_WINDOW * side)
    half = max(2, int(np.ceil(_REACH * window)))
    fit = _fit(half, round(window, 1))
    place = start.copy()
    for _ in range(_STEPS):
        patch = cv2.getRectSubPix(smooth, (2 * half + 1, 2 * half + 1), (float(place[0]), float(place[1])))
        _, x, y, xx, xy, yy = fit @ patch.ravel().astype(np.float64)
        determinant = 4 * xx * yy - xy * xy
        if determinant >= 0:
            return start
        step = np.array([xy * y - 2 * yy * x, xy * x - 2 * xx * y]) / determinant
        place = place + np.clip(step, -1.0, 1.0)
        if np.linalg.norm(place - start) > max(_FARTHEST * side, 1.0):
            return start
        if np.abs(step).max() < 1e-4:
            break
    return place


@cache
def _fit(half: int, window: float) -> Floats:
    """Takes a patch, row by row, to the six coefficients of the quadratic that fits it best around its middle."""
    y, x = (axis.ravel().astype(np.float64) for axis in np.mgrid[-half : half + 1, -half : half + 1])
    weight = np.exp(-(x * x + y * y) / (4 * window**2))  # the square root of a Gaussian
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1) * weight[:, None]
    fit: Floats = np.asarray(np.linalg.pinv(terms), np.float64) * weight
    return fit
