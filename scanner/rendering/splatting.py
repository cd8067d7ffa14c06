"""The loops behind pictures of point clouds: points that face the viewer, drawn as squares into a depth buffer."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Ints, compiled

RGBA: TypeAlias = NDArray[np.uint8]
Floats32: TypeAlias = NDArray[np.float32]

_LARGEST_SPLAT = 6
_DENSITY_CELL = 12
_SPLAT_OF_SPACING = 1.2
_SURROUNDED = 5  # of eight neighbours
_OPAQUE = 255


@compiled
def facing(
    points: Floats32, normals: Floats32, axes: Floats32, row_step: int, column_step: int
) -> tuple[Floats32, Ints]:
    """Select from `points` (H, W, 3), NaN for none, subsampled by rows and columns, those whose `normals` face the
    viewer.

    Returns them (N, 3) in the viewer's frame, whose `axes` (3, 3) are unit rows: right, down, forward; and their
    indices into the H · W points, (N,).
    """
    rows = (points.shape[0] - 1) // row_step + 1
    columns = (points.shape[1] - 1) // column_step + 1
    colours = np.empty((rows * columns, 3), np.float32)
    index = np.empty(rows * columns, np.int64)
    count = 0
    for row in range(0, points.shape[0], row_step):
        for column in range(0, points.shape[1], column_step):
            point, normal = points[row, column], normals[row, column]
            away = axes[2, 0] * normal[0] + axes[2, 1] * normal[1] + axes[2, 2] * normal[2]
            if np.isfinite(point[2]) and away < 0:
                for axis in range(3):
                    colours[count, axis] = (
                        axes[axis, 0] * point[0] + axes[axis, 1] * point[1] + axes[axis, 2] * point[2]
                    )
                index[count] = row * points.shape[1] + column
                count += 1
    return colours[:count], index[:count]


@compiled
def shaded_colours(
    colours: NDArray[np.uint8], normals: Floats32, index: Ints, brightness: Floats32, lamp: Floats32
) -> NDArray[np.uint8]:
    """Opaque RGBA (N, 4) of the points `index` (N,) under a `lamp` (3,), a unit vector towards it.

    `colours` (M, 3) and `normals` (M, 3) of all points; `brightness` (256,): table of a colour in full light.
    """
    shaded = np.full((len(index), 4), _OPAQUE, np.uint8)
    for i in range(len(index)):
        normal = normals[index[i]]
        slant = max(np.float32(0), normal[0] * lamp[0] + normal[1] * lamp[1] + normal[2] * lamp[2])
        light = np.float32(0.45) + np.float32(0.55) * min(np.float32(1), slant)
        for channel in range(3):
            bright = light * brightness[colours[index[i], channel]]
            shaded[i, channel] = np.uint8(min(np.float32(255), bright) + np.float32(0.5))
    return shaded


def splatted(pixels: Floats32, colours: RGBA, height: int, width: int) -> RGBA:
    """A picture (height, width, 4) of points (N, 3) at column and row, and a depth, with their `colours` (N, 4).

    Each is drawn as a square that is large enough to close the gaps around it, by the spacing of the points there. The
    nearest hides the others.
    """
    return _splatted(pixels, colours.view(np.uint32)[:, 0], height, width).view(np.uint8).reshape(height, width, 4)


@compiled
def _splatted(pixels: Floats32, colours: NDArray[np.uint32], height: int, width: int) -> NDArray[np.uint32]:
    sides = np.zeros((height // _DENSITY_CELL + 1, width // _DENSITY_CELL + 1), np.int64)
    for i in range(len(pixels)):
        x, y = pixels[i, 0], pixels[i, 1]
        if 0 <= x < width and 0 <= y < height:
            sides[int(y) // _DENSITY_CELL, int(x) // _DENSITY_CELL] += 1
    for row in range(sides.shape[0]):
        for column in range(sides.shape[1]):
            spacing = _DENSITY_CELL / np.sqrt(max(sides[row, column], 1))
            sides[row, column] = min(max(int(np.ceil(_SPLAT_OF_SPACING * spacing)), 1), _LARGEST_SPLAT)

    nearest = np.full((height, width), np.inf, np.float32)
    picture = np.zeros((height, width), np.uint32)
    for i in range(len(pixels)):
        x, y, depth = pixels[i]
        if not (0 <= x < width and 0 <= y < height):
            continue
        side = sides[int(y) // _DENSITY_CELL, int(x) // _DENSITY_CELL]
        left, top = int(np.floor(x - 0.5 * (side - 1))), int(np.floor(y - 0.5 * (side - 1)))
        for row in range(max(top, 0), min(top + side, height)):
            for column in range(max(left, 0), min(left + side, width)):
                if depth < nearest[row, column]:
                    nearest[row, column] = depth
                    picture[row, column] = colours[i]
    return picture


@compiled
def filled(picture: RGBA) -> RGBA:
    """Transparent pixels take the mean of the opaque ones that they are mostly surrounded by; the border stays."""
    result = picture.copy()
    for row in range(1, picture.shape[0] - 1):
        for column in range(1, picture.shape[1] - 1):
            if picture[row, column, 3]:
                continue
            beside = picture[row, column - 1, 3] | picture[row, column + 1, 3]
            # Without these four, at most four of the eight are opaque.
            if not (beside | picture[row - 1, column, 3] | picture[row + 1, column, 3]):
                continue
            count, red, green, blue = 0, 0, 0, 0
            for y in range(row - 1, row + 2):
                for x in range(column - 1, column + 2):
                    if picture[y, x, 3]:
                        count += 1
                        red += picture[y, x, 0]
                        green += picture[y, x, 1]
                        blue += picture[y, x, 2]
            if count >= _SURROUNDED:
                result[row, column, 0] = (red + count // 2) // count
                result[row, column, 1] = (green + count // 2) // count
                result[row, column, 2] = (blue + count // 2) // count
                result[row, column, 3] = _OPAQUE
    return result


@compiled
def halved(picture: RGBA) -> RGBA:
    """Squares of two by two pixels become one: colours are the means of the opaque ones, opacity is their share."""
    result = np.zeros((picture.shape[0] // 2, picture.shape[1] // 2, 4), np.uint8)
    for row in range(result.shape[0]):
        for column in range(result.shape[1]):
            count, red, green, blue = 0, 0, 0, 0
            for y in range(2 * row, 2 * row + 2):
                for x in range(2 * column, 2 * column + 2):
                    if picture[y, x, 3]:
                        count += 1
                        red += picture[y, x, 0]
                        green += picture[y, x, 1]
                        blue += picture[y, x, 2]
            if count:
                result[row, column, 0] = (red + count // 2) // count
                result[row, column, 1] = (green + count // 2) // count
                result[row, column, 2] = (blue + count // 2) // count
                result[row, column, 3] = (_OPAQUE * count + 2) // 4
    return result
