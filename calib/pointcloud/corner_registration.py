"""Registration of several views of one corner: the correspondence of its three legs.

A view has its points in the corner's frame and in the camera's. The faces of two views correspond up to a cyclic order.
A square corner has a threefold symmetry about its diagonal, so its angles do not determine the order. Three kinds of
evidence do: free space that one view looked through cannot contain another's surface; the texture of the walls is the
same; and a rig is rarely turned on its side between views.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from operator import itemgetter

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.geometry import Corner, Intrinsics
from calib.numerics import Bools, Floats, Ints


@dataclass(frozen=True)
class CornerView:
    """One capture of a corner.

    `points` (H, W, 3) in the camera's frame on its pixel grid, NaN where there is none; `brightness` (H, W), or None;
    `corner` in the same frame and unit.
    """

    points: NDArray[np.float32]
    brightness: NDArray[np.float32] | None
    camera: Intrinsics
    corner: Corner

    @cached_property
    def axes(self) -> Floats:
        """The corner's axes, (3, 3) rows in the camera's frame; as of `Corner.axes`."""
        return self.corner.axes

    @cached_property
    def there(self) -> Bools:
        """Which pixels have a point, (H, W)."""
        return np.isfinite(self.points[..., 2])

    @cached_property
    def distance(self) -> float:
        """Median distance of the points from the camera."""
        return float(np.median(np.linalg.norm(self.points[self.there], axis=1))) if self.there.any() else 0.0

    def in_corner(self, points: Floats, turn: int = 0) -> Floats:
        """Points (N, 3) of the camera's frame in the corner's; `turn` renumbers its axes cyclically."""
        return np.roll((points - self.corner.vertex) @ self.axes.T, turn, axis=1)

    def in_camera(self, points: Floats, turn: int = 0) -> Floats:
        """The inverse of `in_corner`."""
        return np.roll(points, -turn, axis=1) @ self.axes + self.corner.vertex

    def depths_around(self, points: Floats) -> tuple[Floats, Floats, Bools]:
        """Smallest and largest depth (N,) in the 3 × 3 pixels around the images of points (N, 3) in the camera's
        frame, and whether there is any (N,).
        """
        pixels = self.camera.project(points)
        with np.errstate(invalid="ignore"):
            sees = (points[:, 2] > 0) & np.all(
                (pixels >= 0) & (pixels <= np.array(self.there.shape[::-1]) - 1.0), axis=1
            )
        column, row = np.rint(pixels[sees]).astype(np.int64).T
        height, width = self.there.shape
        around = np.stack(
            [
                self.points[np.clip(row + dy, 0, height - 1), np.clip(column + dx, 0, width - 1), 2]
                for dy, dx in product((-1, 0, 1), repeat=2)
            ]
        )
        nearest, farthest = np.full(len(points), np.nan), np.full(len(points), np.nan)
        nearest[sees] = np.fmin.reduce(around)
        farthest[sees] = np.fmax.reduce(around)
        return nearest, farthest, np.isfinite(nearest)


def cells_of(points: Floats, size: float) -> Ints:
    """The index (N,) of the voxel, with edges of `size`, that contains each point (N, 3)."""
    cell = np.floor(points / size).astype(np.int64) if len(points) else np.zeros((0, 3), np.int64)
    cell -= cell.min(axis=0, initial=0)
    extent = cell.max(axis=0, initial=0) + 1
    numbers: Ints = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
    return numbers


_TURNS = (0, 1, 2)
# Shares of the distance: size of a patch of points, and the largest difference of equal depths.
_PATCH, _SAME_DEPTH = 0.02, 0.01
# Cost of a patch in the other view's line of sight. Decoder errors and moved things cause some, and patches are not
# independent, so each counts far less than it would alone.
_NATS_PER_PATCH = 0.5
# Pixel size of the wall textures that are compared, as a share of the distance; window in pixels over which
# illumination is removed.
_WALL_PIXEL, _WINDOW = 0.005, 15
# How many correlated texture pixels count as one independent pixel.
_ALIKE_NEIGHBOURS = 50.0
_UPRIGHT_SIGMA = np.radians(45.0)
# The best order must be 1000 times as likely as the next.
_DECIDED_NATS = float(np.log(1000.0))
_MOST_REFUTED = 0.5
_MOST_BEGUN = 3**6


@dataclass(frozen=True)
class Order:
    """The correspondence of the axes of several views' corners.

    `turns`: for each view the argument of `View.in_corner`. `nats`: log likelihood ratio to the next best order.
    `refuted`: share of the patches off the walls, visible to both views, that the other view looked through; small for
    the right order of an unchanged scene.
    """

    turns: tuple[int, ...]
    nats: float
    refuted: float

    @property
    def decided(self) -> bool:
        """Whether the views themselves determine the order."""
        return self.nats >= _DECIDED_NATS and not self.contradictory

    @property
    def contradictory(self) -> bool:
        """Whether the views contradict each other even in this order."""
        return self.refuted > _MOST_REFUTED


@dataclass(frozen=True)
class _Seen:
    """Counts of one view's patches as seen by another: refuted ones, and confirmed ones off the walls."""

    refuted: int
    refuted_off_walls: int
    confirmed_off_walls: int


def find_order(views: Sequence[CornerView], angles_nats: float = 0.0) -> Order:
    """The likeliest order of the axes of two or more views, with its log likelihood ratio.

    `angles_nats`: log likelihood ratio by which the corner's angles favour the given order.
    """
    patches = [_patches(view) for view in views]
    pixel = _WALL_PIXEL * float(np.median([view.distance for view in views]))
    walls = [_pictures_of_walls(view, pixel) for view in views]
    costs, overlaps = {}, {}
    for i, j in combinations(range(len(views)), 2):
        for turn in _TURNS:
            both = _seen_by(views[i], patches[j], turn), _seen_by(views[j], patches[i], -turn)
            overlaps[i, j, turn] = both
            costs[i, j, turn] = (
                _NATS_PER_PATCH * sum(overlap.refuted for overlap in both)
                + _cost_of_paint(walls[i], walls[j], turn)
                + _cost_of_tilt(views[i], views[j], turn)
                + (angles_nats if turn else 0.0)
            )

    (best, least), (_, next_least), *_ = _cheapest(costs, len(views))
    chosen = [
        overlap for i, j in combinations(range(len(views)), 2) for overlap in overlaps[i, j, (best[j] - best[i]) % 3]
    ]
    refuted = sum(overlap.refuted_off_walls for overlap in chosen)
    confirmed = sum(overlap.confirmed_off_walls for overlap in chosen)
    return Order(_upright(views, best), next_least - least, refuted / max(1, refuted + confirmed))


def _cheapest(costs: Mapping[tuple[int, int, int], float], count: int) -> list[tuple[tuple[int, ...], float]]:
    """Turns of `count` views, the first being 0, with the sums of their pairs' costs, cheapest first.

    A beam search, view by view; exhaustive for up to seven views.
    """
    begun: list[tuple[tuple[int, ...], float]] = [((0,), 0.0)]
    for j in range(1, count):
        longer = [
            ((*turns, turn), cost + sum(costs[i, j, (turn - turns[i]) % 3] for i in range(j)))
            for turns, cost in begun
            for turn in _TURNS
        ]
        begun = sorted(longer, key=itemgetter(1))[:_MOST_BEGUN]
    return begun


def _upright(views: Sequence[CornerView], turns: tuple[int, ...]) -> tuple[int, ...]:
    """The same order, renumbered so that the last axis is the most upright one in the cameras' images."""
    up = np.mean([_up(view, turn) for view, turn in zip(views, turns, strict=True)], axis=0)
    shift = 2 - int(np.argmax(np.abs(up)))
    return tuple((turn + shift) % 3 for turn in turns)


def _up(view: CornerView, turn: int) -> Floats:
    """The camera's up in the corner's frame, (3,)."""
    return np.roll(view.axes @ np.array([0.0, -1.0, 0.0]), turn)


def _cost_of_tilt(a: CornerView, b: CornerView, turn: int) -> float:
    angle = np.arccos(np.clip(_up(a, 0) @ _up(b, turn), -1, 1))
    return float(0.5 * (angle / _UPRIGHT_SIGMA) ** 2)


@dataclass(frozen=True)
class _Patches:
    """One point (N, 3) for each patch, in the corner's frame; `off_walls` (N,): clearly before the three faces."""

    points: Floats
    off_walls: Bools


def _patches(view: CornerView) -> _Patches:
    points = view.in_corner(view.points[view.there].astype(np.float64))
    size = _PATCH * view.distance
    _, first = np.unique(cells_of(points, size), return_index=True)
    return _Patches(points[first], np.min(np.abs(points[first]), axis=1) > size)


def _seen_by(view: CornerView, patches: _Patches, turn: int) -> _Seen:
    """Classify patches by what the view saw there; `turn`: of the patches' corner relative to the view's."""
    points = view.in_camera(np.roll(patches.points, turn, axis=1))
    nearest, farthest, sees = view.depths_around(points)
    z = points[:, 2]
    through = sees & (nearest > (1 + _SAME_DEPTH) * z)
    meets = sees & ~through & (farthest > (1 - _SAME_DEPTH) * z)
    off = patches.off_walls
    return _Seen(int(through.sum()), int((through & off).sum()), int((meets & off).sum()))


@dataclass(frozen=True)
class _Wall:
    """The texture of a face over its two other axes: log brightness (h, w), high-pass filtered to remove illumination.

    `known` (h, w): pixels with a point; `origin` (2,): position of the first pixel.
    """

    paint: Floats
    known: Bools
    origin: Ints

    def within(self, low: Ints, high: Ints) -> tuple[Floats, Bools]:
        """The texture and its validity from position `low` (2,) up to `high` (2,), which must be inside."""
        rows, columns = (slice(*ends) for ends in zip(low - self.origin, high - self.origin, strict=True))
        return self.paint[rows, columns], self.known[rows, columns]


def _pictures_of_walls(view: CornerView, pixel: float) -> list[_Wall] | None:
    """The textures of the three faces; None if the brightness is unknown."""
    if view.brightness is None or not view.there.any() or pixel == 0:
        return None
    points = view.in_corner(view.points[view.there].astype(np.float64))
    light = np.log(np.maximum(view.brightness[view.there].astype(np.float64), 1.0))
    walls = []
    for face in range(3):
        on_wall = np.abs(points[:, face]) < _SAME_DEPTH * view.distance
        places = np.floor(points[on_wall][:, [(face + 1) % 3, (face + 2) % 3]] / pixel).astype(np.int64)
        walls.append(_picture_of_wall(places, light[on_wall]))
    return walls


def _picture_of_wall(places: Ints, light: Floats) -> _Wall:
    """The texture from integer positions (N, 2) and log brightness (N,)."""
    origin = places.min(axis=0, initial=0)
    height, width = places.max(axis=0, initial=0) - origin + 1
    flat = (places[:, 0] - origin[0]) * width + places[:, 1] - origin[1]
    count = np.bincount(flat, minlength=height * width).reshape(height, width)
    total = np.bincount(flat, light, minlength=height * width).reshape(height, width)
    known = count > 0
    mean = total / np.maximum(count, 1)
    around = scipy.ndimage.uniform_filter(mean, _WINDOW) / np.maximum(
        scipy.ndimage.uniform_filter(known.astype(np.float64), _WINDOW), 1e-9
    )
    return _Wall(np.where(known, mean - around, 0.0), known, origin)


def _cost_of_paint(a: list[_Wall] | None, b: list[_Wall] | None, turn: int) -> float:
    """−log likelihood of the correlation r of the walls' textures: ½ n log(1 − r²), if r is positive."""
    if a is None or b is None:
        return 0.0
    products, count = np.zeros(3), 0
    for face in range(3):
        first, second = a[(face + turn) % 3], b[face]
        low = np.maximum(first.origin, second.origin)
        high = np.minimum(first.origin + first.paint.shape, second.origin + second.paint.shape)
        if np.any(high <= low):
            continue
        (x, known_x), (y, known_y) = first.within(low, high), second.within(low, high)
        x, y = x[known_x & known_y], y[known_x & known_y]
        products += [x @ y, x @ x, y @ y]
        count += len(x)
    if not products[1] * products[2] > 0:
        return 0.0
    correlation = min(max(0.0, products[0] / np.sqrt(products[1] * products[2])), 0.99)
    return float(0.5 * count / _ALIKE_NEIGHBOURS * np.log(1 - correlation**2))
