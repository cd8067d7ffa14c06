"""Refine the corners of a chessboard to a few hundredths of a pixel: the saddle points of its brightness.

L. Lucchese and S. Mitra, Using saddle points for subpixel feature detection in camera calibration targets, APCCAS 2002.
OpenCV's sector-based detector scales small squares up, and then its grid is some tenths of a per cent too large.
"""

from functools import cache

import cv2
import numpy as np

from calib.geometry import homography_between, mapped
from calib.numerics import Floats, Image

_BLUR, _WINDOW = 0.08, 0.08  # standard deviations, in squares
_LEAST_BLUR_PX, _LEAST_WINDOW_PX = 0.8, 1.0
_REACH = 1.5  # in standard deviations of the window
_STEPS = 8
_FARTHEST = 0.2  # largest distance in squares from the detected position


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
    window = max(_LEAST_WINDOW_PX, _WINDOW * side)
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
