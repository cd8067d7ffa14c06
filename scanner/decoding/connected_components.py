"""Find connected components by runs, of which images of large surfaces have few per row."""

import numpy as np

from calib.numerics import Bools, Ints, compiled
from scanner.decoding.tiles import in_strips, widened

SMALLEST_PATCH = 24  # pixels; fewer are taken for outliers that happen to touch
_ROWS = 512  # at once, of which twice the smallest patch is searched twice


def small_patches(image: Bools) -> Bools:
    """Return the pixels of an image (H, W) in 4-connected components of fewer than `SMALLEST_PATCH` pixels."""
    result = np.empty_like(image)

    def find(rows: slice) -> None:
        # A component that reaches beyond the widened rows is not small.
        wider, inner = widened(rows, SMALLEST_PATCH, len(image))
        large = image[wider].copy()
        _remove_small(large)
        np.greater(image[rows], large[inner], out=result[rows])

    in_strips(len(image), _ROWS, find)
    return result


def _remove_small(image: Bools) -> None:
    """Clear the small components of an image (H, W), in place."""
    starts = image[:, 0].sum() + np.count_nonzero(image[:, 1:] > image[:, :-1])
    runs = np.empty((3, starts), np.int32)
    _remove(image, *runs)


@compiled
def _remove(image: Bools, begin: Ints, end: Ints, parent: Ints) -> None:
    """Clear the small components; `begin`, `end`, `parent` (runs,) are work arrays, `end` exclusive."""
    height, width = image.shape
    size = np.zeros(len(begin), np.int32)
    row_ends = np.zeros(height, np.int64)
    above, above_end, run = 0, 0, 0
    for row in range(height):
        of_row = image[row]
        column = 0
        while column < width:
            while column < width and not of_row[column]:
                column += 1
            if column == width:
                break
            begin[run] = column
            while column < width and of_row[column]:
                column += 1
            end[run], parent[run], size[run] = column, run, column - begin[run]
            while above < above_end and end[above] <= begin[run]:
                above += 1
            overlapping = above
            while overlapping < above_end and begin[overlapping] < column:
                _join(run, overlapping, parent, size)
                overlapping += 1
            run += 1
        above, above_end, row_ends[row] = above_end, run, run
    run = 0
    for row in range(height):
        while run < row_ends[row]:
            if size[_root(run, parent)] < SMALLEST_PATCH:
                image[row, begin[run] : end[run]] = False
            run += 1


@compiled
def _root(run: int, parent: Ints) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@compiled
def _join(one: int, other: int, parent: Ints, size: Ints) -> None:
    one, other = _root(one, parent), _root(other, parent)
    if one != other:
        parent[one] = other
        size[other] += size[one]
