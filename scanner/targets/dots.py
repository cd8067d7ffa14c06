"""Correct the perspective bias of circle centres: the centre of a dot's image is not the image of its centre.

J. Heikkilä, Geometric camera calibration using circular control points, PAMI 22 (2000). Both centres are computed here
from the board's homography and the measured radius of the dots, and the difference is subtracted.
"""

import cv2
import numpy as np

from calib.geometry import homography_between, mapped
from calib.numerics import Floats, Image

_RIM = 48  # samples around a dot
_STEP = 1e-3  # of the dots' distance
_WINDOW = 0.45  # half a window around a dot, in distances to its neighbour


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
        half = max(2, int(_WINDOW * spacing * np.sqrt(scale)))
        column, row = round(float(x)), round(float(y))
        window = grey[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
        _, binary = cv2.threshold(window, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        middle = binary[min(half, row), min(half, column)] if binary.size else 0
        _, labels = cv2.connectedComponents((binary == middle).astype(np.uint8))
        area = np.count_nonzero(labels == labels[min(half, row), min(half, column)])
        radii.append(np.sqrt(area / (np.pi * scale)))
    return float(np.clip(np.median(radii), 0.0, _WINDOW * spacing))


def _centroids(outlines: Floats) -> Floats:
    """Return the centroids (N, 2) of polygons (N, K, 2)."""
    following = np.roll(outlines, -1, axis=1)
    cross = outlines[..., 0] * following[..., 1] - outlines[..., 1] * following[..., 0]
    total = np.sum((outlines + following) * cross[..., None], axis=1)
    centroids: Floats = total / (3 * np.sum(cross, axis=1))[:, None]
    return centroids
