"""The share of light of each projector where several overlap: smooth weights that add up to one.

The weight of a projector is the square of the distance, in its image, from the edge of its region, over the sum of all
projectors' there. At its edge it vanishes smoothly. An edge is that of the image, the content, a hole, or an occlusion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.geometry import Distortion, Pinhole, distorted_point
from calib.numerics import Bools, Floats, compiled
from scanner.exporting.mapping.projector_view import Numbers, ProjectorView
from scanner.io import RowFile, in_rows

_EDGE = 0.02  # relative depth step to a neighbour, beyond that of a plane
_SAME = 0.005  # relative depth difference within one surface


@dataclass(frozen=True, eq=False)
class LitRegion:
    """What a projector shows of the content: the `distance` (H, W) of the pixels of its `view` from the nearest edge,
    over the image's height, 0 where it shows nothing.
    """

    view: ProjectorView
    distance: RowFile


def distance_from_edge(view: ProjectorView, lit: Bools) -> Numbers:
    """Distance (H, W) of the `lit` pixels from the nearest that is not, or has a step, over the image's height."""
    height, width = lit.shape
    inside = np.zeros((height + 2, width + 2), np.uint8)

    def find(rows: slice) -> None:
        inside[1:-1, 1:-1][rows] = lit[rows] & _without_steps(view, rows)

    in_rows(lit.shape, find)
    distance = np.asarray(cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1], np.float32)
    np.maximum(distance, 0.5, out=distance)  # pixels at the very edge need a projector, too
    distance *= lit
    distance /= height
    return distance


def _without_steps(view: ProjectorView, rows: slice) -> Bools:
    """Pixels (n, W) of some rows whose depth does not step beside them."""
    height = view.depth.shape[0]
    around = slice(max(0, rows.start - 1), min(height, rows.stop + 1))
    depth = view.depth.read(around)
    smooth = np.empty(depth.shape, np.bool_)
    _find_steps(depth, _EDGE, smooth)
    return smooth[rows.start - around.start :][: rows.stop - rows.start]


def summed_squares(region: LitRegion, regions: Sequence[LitRegion], to_file: Floats) -> Numbers:
    """The sum (H, W) of squared distances of all projectors' pixels that light what the pixels of `region` do.

    `to_file` (3,): factors from the scene's axes to those of positions and depth. One other projector is in memory at a
    time.
    """
    total = np.square(region.distance.read_all())
    for neighbour in regions:
        if neighbour is not region:
            _add_region(neighbour, region.view.position, to_file, total)
    return total


def _add_region(region: LitRegion, position: RowFile, to_file: Floats, total: Numbers) -> None:
    """Add to the `total` (H, W) the squared distances of the pixels that light the points at `position`."""
    scale = abs(to_file[0])
    place, lens = region.view.projector.place, region.view.projector.intrinsics
    into = place.inverse().scaled(scale)
    turn, shift = scale * into.rotation / to_file, into.translation
    # Side by side, as both are read at the same places; the inverse of the depth, which is linear on a plane.
    surface = np.empty((*region.distance.shape, 2), np.float32)

    def load(rows: slice) -> None:
        _pair(region.view.depth.read(rows), region.distance.read(rows), surface[rows])

    def add(rows: slice) -> None:
        points, sums = position.read(rows).reshape(-1, 3), total[rows].reshape(-1)
        _add_squares(turn, shift, lens.distortion, lens.pinhole, surface, _SAME, points, sums)

    in_rows(surface.shape, load)
    in_rows(total.shape, add)


def weights(region: LitRegion, total: Numbers, rows: slice) -> Numbers:
    """Weights (n, W) in linear light of some rows of a projector's pixels, 0 where it shows nothing."""
    squares: Numbers = np.square(region.distance.read(rows))
    squares /= np.where(total[rows] > 0, total[rows], np.float32(1))
    return squares


@compiled
def _find_steps(depth: Numbers, edge: float, smooth: Bools) -> None:
    """Inverse depth of a plane is linear in the image: where its second differences are small, and where unknown."""
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            here = depth[y, x]
            steps = 0.0
            if here > 0 and 0 < x < width - 1 and depth[y, x - 1] > 0 and depth[y, x + 1] > 0:
                steps = abs(here / depth[y, x - 1] + here / depth[y, x + 1] - 2.0)
            if here > 0 and 0 < y < height - 1 and depth[y - 1, x] > 0 and depth[y + 1, x] > 0:
                steps = max(steps, abs(here / depth[y - 1, x] + here / depth[y + 1, x] - 2.0))
            smooth[y, x] = steps < edge


@compiled
def _pair(depth: Numbers, distance: Numbers, surface: Numbers) -> None:
    """The inverse depth, 0 where none is known, and the distance from the edge, (n, W, 2)."""
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            surface[y, x, 0] = 1.0 / depth[y, x] if depth[y, x] > 0 else 0.0
            surface[y, x, 1] = distance[y, x]


@compiled
def _add_squares(
    turn: Floats,
    shift: Floats,
    distortion: Distortion,
    pinhole: Pinhole,
    surface: Numbers,
    same: float,
    points: Numbers,
    total: Numbers,
) -> None:
    """Add to the `total` (N,) of each point (N, 3), unless it is 0, the square of another projector's distance from its
    edge, interpolated, where that lights the same point.

    `surface` (H, W, 2): of the other projector's pixels, as in `_pair`.
    """
    height, width = surface.shape[:2]
    for i in range(len(points)):
        if not total[i] > 0.0:
            continue
        z = turn[2, 0] * points[i, 0] + turn[2, 1] * points[i, 1] + turn[2, 2] * points[i, 2] + shift[2]
        if not z > 0.0:
            continue
        per_z = 1.0 / z
        x = (turn[0, 0] * points[i, 0] + turn[0, 1] * points[i, 1] + turn[0, 2] * points[i, 2] + shift[0]) * per_z
        y = (turn[1, 0] * points[i, 0] + turn[1, 1] * points[i, 1] + turn[1, 2] * points[i, 2] + shift[1]) * per_z
        u, v, _, _, _ = distorted_point(x, y, distortion)
        u, v = pinhole[0] * u + pinhole[2], pinhole[1] * v + pinhole[3]
        if not (0.0 <= u <= width - 1 and 0.0 <= v <= height - 1):
            continue
        left, top = int(u), int(v)
        right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
        across, down = u - left, v - top
        a, b = surface[top, left, 0], surface[top, right, 0]
        c, d = surface[bottom, left, 0], surface[bottom, right, 0]
        if not (min(a, b, c, d) > 0):
            continue
        inverse = (1.0 - down) * ((1.0 - across) * a + across * b) + down * ((1.0 - across) * c + across * d)
        if abs(1.0 - z * inverse) < same * z * inverse:
            a, b = surface[top, left, 1], surface[top, right, 1]
            c, d = surface[bottom, left, 1], surface[bottom, right, 1]
            edge = (1.0 - down) * ((1.0 - across) * a + across * b) + down * ((1.0 - across) * c + across * d)
            total[i] += edge * edge
