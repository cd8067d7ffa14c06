"""Points on the camera's pixel grid: triangulated matches, of which the smallest ray miss is kept where several share a
pixel, and index grids (H, W) with the point of each pixel.

Points are sparse in the camera's image if the projector's pixels are larger than the camera's and a decoder returns one
match for each. Gaps between them are filled with the nearest point.
"""

from dataclasses import dataclass
from math import ceil, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Matches, intersect_rays
from calib.numerics import Floats, Ints, by_columns, compiled, in_pieces, in_slices, slices_of
from calib.pointcloud.triangulation_errors import RayGapModel, expected_misses

_SAMPLE = 20_000  # the noise of so many misses is known to 0.8 %
_STRIP_ROWS = 64
_IN_TURN = 1 << 16  # matches at a time, if they must not be placed in parallel
# Indices into the array of counts.
_OUTSIDE, _BEHIND, _DISAGREEING, _SHARED, _FATES = 0, 1, 2, 3, 4
NONE = -1
_WINDOW_PX = 15
_LARGEST_SMALL_GRID, _CELLS_PER_POINT = 8_000_000, 16
# Among unevenly spaced points, the next one is rarely farther than this many spacings.
_REACH_OF_SPACING = 1.5


@dataclass(frozen=True)
class Organised:
    """Triangulated matches on the grid, and counts of those that were dropped, as in `CloudStatistics`."""

    points: NDArray[np.float32]
    """In the camera's frame, NaN where there is none, (H, W, 3)."""
    residual_px: NDArray[np.float32]
    """Ray miss of the point, or of one dropped for it, NaN where no rays met, (H, W)."""
    match: NDArray[np.int32]
    """Index of each point's match, (H, W)."""
    outside_image: int
    behind: int
    disagreeing: int
    shared_pixel: int
    misses: RayGapModel
    """Model of the misses."""
    trend_px: float
    """Root mean square of their smooth part."""


def organise(matches: Matches, calibration: Calibration) -> Organised:
    """Triangulate every match, test whether its rays meet, and store its point at the camera's pixel."""
    count, shape = len(matches), (calibration.camera.height, calibration.camera.width)
    misses = _expected_misses(matches, calibration)
    points, residual_px = np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
    match = np.zeros(shape, np.int32)

    def clear(rows: slice) -> None:
        points[rows] = np.nan
        residual_px[rows] = np.nan

    def place(at: slice) -> tuple[Ints, float]:
        fates, camera_px = np.zeros(_FATES, np.int64), by_columns(matches.camera_px[at])
        met = intersect_rays(camera_px, matches.projector_px[at], calibration)
        trend_px = misses.trend_px(camera_px, met.foot_px, calibration)
        squared_trend = _place(
            at.start,
            camera_px.T,
            met.points.T,
            met.residual_px,
            trend_px,
            misses.limit_px,
            points,
            residual_px,
            match,
            fates,
        )
        return fates, squared_trend

    in_slices(shape[0], _STRIP_ROWS, clear)
    # In parallel only if no two threads can write to the same pixel.
    side_by_side = _row_by_row(matches, calibration.camera.width)
    placed = in_pieces(count, place) if side_by_side else [place(at) for at in slices_of(count, _IN_TURN)]
    fates = np.stack([fates for fates, _ in placed]).sum(axis=0)
    agreeing = count - int(fates[[_OUTSIDE, _BEHIND, _DISAGREEING]].sum())
    squared_trend = sum(squared for _, squared in placed)
    return Organised(
        points,
        residual_px,
        match,
        int(fates[_OUTSIDE]),
        int(fates[_BEHIND]),
        int(fates[_DISAGREEING]),
        int(fates[_SHARED]),
        misses,
        float(np.sqrt(squared_trend / max(agreeing, 1))),
    )


def _expected_misses(matches: Matches, calibration: Calibration) -> RayGapModel:
    """The model of ray misses, from a sample of the matches."""
    step = max(1, len(matches) // _SAMPLE)
    camera_px = by_columns(matches.camera_px[::step])
    met = intersect_rays(camera_px, matches.projector_px[::step], calibration)
    there = met.in_front
    return expected_misses(camera_px[there], met.foot_px[there], met.residual_px[there], calibration)


def _row_by_row(matches: Matches, width: int) -> bool:
    """Whether matches are in the order of the camera's pixels, at most one for each, as a decoder returns them."""

    def in_order(at: slice) -> bool:
        return _increase(matches.camera_px[max(0, at.start - 1) : at.stop], width)

    return all(in_pieces(len(matches), in_order))


@compiled
def _increase(camera_px: Floats, width: int) -> bool:
    """Whether the row-major indices of pixels (N, 2) increase."""
    last, wrong = -np.inf, 0
    for i in range(len(camera_px)):
        number = np.rint(camera_px[i, 1]) * width + np.rint(camera_px[i, 0])
        wrong += number <= last
        last = number
    return wrong == 0


@compiled
def _place(
    first: int,
    camera_px: Floats,
    points: Floats,
    residual_px: Floats,
    trend_px: Floats,
    limit_px: float,
    grid: NDArray[np.float32],
    grid_residual_px: NDArray[np.float32],
    grid_match: NDArray[np.int32],
    fates: Ints,
) -> float:
    """Store points (3, N) of camera pixels (2, N) on the grid, and count dropped ones; `first`: index of match 0.

    Returns the sum of squared trends of the agreeing ones.
    """
    height, width = grid_residual_px.shape
    squared_trend = 0.0
    for i in range(len(residual_px)):
        column, row, residual = np.rint(camera_px[0, i]), np.rint(camera_px[1, i]), residual_px[i]
        if not (0 <= column < width and 0 <= row < height):
            fates[_OUTSIDE] += 1
        elif not np.isfinite(residual):
            fates[_BEHIND] += 1
        else:
            x, y = int(column), int(row)
            taken = not np.isnan(grid[y, x, 2])
            # The trend may be wrong where few matches determine it; rays that meet without it are never dropped.
            agrees = min(abs(residual - trend_px[i]), abs(residual)) <= limit_px
            if agrees:
                squared_trend += trend_px[i] * trend_px[i]
                fates[_SHARED] += taken
            else:
                fates[_DISAGREEING] += 1
            rounded = np.float32(residual)
            if not taken or (agrees and abs(rounded) < abs(grid_residual_px[y, x])):
                grid_residual_px[y, x] = rounded
                if agrees:
                    grid_match[y, x] = first + i
                    for axis in range(3):
                        grid[y, x, axis] = points[axis, i]
    return squared_trend


def index_grid(pixel: Ints, size: tuple[int, int]) -> Ints:
    """The grid of points at pixels (N, 2), column and row, in an image of `size` (width, height)."""
    grid = np.full(size[::-1], NONE, np.int32)
    grid[pixel[:, 1], pixel[:, 0]] = np.arange(len(pixel), dtype=np.int32)
    return grid


def grid_step(count: int, size: tuple[int, int]) -> int:
    """The step in pixels of a grid over an image of `size` (width, height) that takes little more memory than `count`
    points; 1 unless these are few in a huge image.
    """
    return ceil(sqrt(size[0] * size[1] / max(_LARGEST_SMALL_GRID, _CELLS_PER_POINT * count)))


def density(index: Ints) -> float:
    """Points per pixel where there are points: nearly 1 if every pixel has one; 0 for none."""
    there = index != NONE
    if not there.any():
        return 0.0
    size = (_WINDOW_PX, _WINDOW_PX)
    around = cv2.boxFilter(there.astype(np.float32), cv2.CV_32F, size, normalize=True, borderType=cv2.BORDER_CONSTANT)
    return float(np.median(np.asarray(around)[there]))


def without_gaps(index: Ints) -> Ints:
    """The same grid with pixels between sparse points assigned to the nearest point; holes stay holes."""
    spacing = 1 / np.sqrt(max(density(index), 1 / _WINDOW_PX**2))
    empty = (index == NONE).astype(np.uint8)
    if spacing < 1.1 or empty.all():
        return index
    distance, label = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    point_of_label = np.full(int(label.max()) + 1, NONE, np.int64)
    point_of_label[label[empty == 0]] = index[empty == 0]
    return np.where(distance <= _REACH_OF_SPACING * spacing, point_of_label[label], NONE)
