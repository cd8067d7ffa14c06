"""Where a thin sample of pixels is on planes, and what changes smoothly over these."""

import numpy as np
from numpy.typing import NDArray

from calib.numerics import CONIC, Bools, Floats, Ints, compiled, in_pieces, monomials, orthonormal

_NEAR_PX = 2
_NOBODY, _SEVERAL, _MOST_LABELS = -2, -1, 127
_FEWEST = 100


def planes_at(pixels: Floats, camera_px: Floats, plane: Ints) -> Ints:
    """The plane of camera pixels (P, 2), if all matches around them agree; −1 otherwise.

    `camera_px` (N, 2): pixels of the matches; `plane` (N,): the plane of each, negative for none.
    """
    at, down = pixels.astype(np.int64).T
    width, height = int(at.max()) + 1, int(down.max()) + 1
    labels = np.full((height + 2 * _NEAR_PX, width + 2 * _NEAR_PX), _NOBODY, np.int8)
    in_pieces(len(plane), lambda at: _note(camera_px[at], plane[at], labels))
    near = np.stack([labels[down + i, at + j] for i in range(2 * _NEAR_PX + 1) for j in range(2 * _NEAR_PX + 1)])
    greatest = near.max(axis=0)
    agree = np.all((near == greatest) | (near == _NOBODY), axis=0)
    return np.where(agree, np.maximum(greatest, _SEVERAL), _SEVERAL).astype(np.int32)


@compiled
def _note(camera_px: Floats, plane: Ints, labels: NDArray[np.int8]) -> None:
    """Write the planes of matches (N, 2) into an image with a border; planes that exceed a byte are left out."""
    height, width = labels.shape
    for i in range(len(plane)):
        row, column = int(camera_px[i, 1] + 0.5) + _NEAR_PX, int(camera_px[i, 0] + 0.5) + _NEAR_PX
        if row < height and column < width:
            labels[row, column] = max(plane[i], _SEVERAL) if plane[i] <= _MOST_LABELS else _SEVERAL


def smooth_over(plane: Ints, points: Floats, chosen: Bools) -> tuple[Floats, Bools]:
    """An orthonormal basis (N, M) of what changes up to second order over each plane, for the chosen pixels that are on
    one of some size.
    """
    large = [number for number in np.unique(plane[chosen]) if np.sum(chosen & (plane == number)) >= _FEWEST]
    chosen = chosen & np.isin(plane, large)
    here, where = points[chosen], plane[chosen]
    columns = np.zeros((len(here), CONIC * len(large)))
    for number, label in enumerate(large):
        on = where == label
        columns[on, CONIC * number : CONIC * (number + 1)] = monomials(here[on])[:, :CONIC]
    return orthonormal(columns), chosen
