"""Several views of one corner: which of its three legs is which.

A corner's faces are numbered alike up to a cyclic order, which angles of exactly 90 degrees do not tell: turned by a
third about its diagonal, a square corner is the same. What else the views saw tells the orders apart: where one view
looked through the air there is nothing that another could have seen; what is painted on the walls is the same in both;
and a rig is seldom moved and turned on its side at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from calib.arrays import Bools, Floats, Ints
from calib.camera import Intrinsics
from calib.corner import Corner

_TURNS = (0, 1, 2)
# Of the distance: neighbouring points are one patch, one piece of evidence; depths that differ by less are the same.
_PATCH, _SAME_DEPTH = 0.02, 0.01
# A patch in the other's line of sight is a mistake of the decoder or a thing that was moved, else a refutation. Patches
# are not independent, so each counts for far less than it would alone.
_NATS_PER_PATCH = 0.5
# Of the distance: pixels of the pictures of the walls that are compared; what is dark here and there for want of light
# is evened out over a window of so many.
_WALL_PIXEL, _WINDOW = 0.005, 15
# Of the pixels of these pictures, as many as this one are worth one that is independent of the others.
_ALIKE_NEIGHBOURS = 50.0
_UPRIGHT_SIGMA = np.radians(45.0)
# One order has to be 1000 times as likely as the next.
_DECIDED_NATS = float(np.log(1000.0))
_MOST_REFUTED = 0.5
_MOST_BEGUN = 3**6


@dataclass(frozen=True)
class View:
    """What one capture saw of a corner.

    `points` (H, W, 3) in the camera's frame on its pixel grid, NaN where there is none; `brightness` (H, W), or None;
    `corner` in the same frame and unit.
    """

    points: NDArray[np.float32]
    brightness: NDArray[np.float32] | None
    camera: Intrinsics
    corner: Corner

    @cached_property
    def axes(self) -> Floats:
        """Right-handed orthonormal rows (3, 3) nearest to the corner's legs, in the camera's frame.

        The nearest rotation (Schönemann 1966); legs that are numbered the left-handed way round change places first.
        """
        legs = self.corner.legs
        u, _, vt = np.linalg.svd(legs if np.linalg.det(legs) > 0 else legs[[0, 2, 1]])
        nearest: Floats = u @ vt
        return nearest

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
        points_in_camera: Floats = np.roll(points, -turn, axis=1) @ self.axes + self.corner.vertex
        return points_in_camera


@dataclass(frozen=True)
class Order:
    """How the axes of several views' corners belong together.

    `turns`: for each view, what `View.in_corner` is to be given. `nats`: log of how much likelier this order is than
    the next. `refuted`: share of the patches off the walls, where both views could see, that the other view looked
    through; with the right order of one unchanged scene it is small.
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
        """Whether even in this order the views do not show one unchanged scene."""
        return self.refuted > _MOST_REFUTED


@dataclass(frozen=True)
class _Seen:
    """Patches of one view as another one saw them: `refuted` of all; of those off the walls also `confirmed`."""

    refuted: int
    refuted_off_walls: int
    confirmed_off_walls: int


def find_order(views: Sequence[View]) -> Order:
    """The likeliest order of the axes of two or more views, and how sure it is."""
    patches = [_patches(view) for view in views]
    pixel = _WALL_PIXEL * float(np.median([view.distance for view in views]))
    walls = [_pictures_of_walls(view, pixel) for view in views]
    costs, seen = {}, {}
    for i, j in combinations(range(len(views)), 2):
        for turn in _TURNS:
            both = _seen_by(views[i], patches[j], turn), _seen_by(views[j], patches[i], -turn)
            seen[i, j, turn] = both
            costs[i, j, turn] = (
                _NATS_PER_PATCH * sum(each.refuted for each in both)
                + _cost_of_paint(walls[i], walls[j], turn)
                + _cost_of_tilt(views[i], views[j], turn)
            )

    (best, least), (_, next_least), *_ = _cheapest(costs, len(views))
    chosen = [each for i, j in combinations(range(len(views)), 2) for each in seen[i, j, (best[j] - best[i]) % 3]]
    refuted = sum(each.refuted_off_walls for each in chosen)
    confirmed = sum(each.confirmed_off_walls for each in chosen)
    return Order(_upright(views, best), next_least - least, refuted / max(1, refuted + confirmed))


def _cheapest(costs: Mapping[tuple[int, int, int], float], count: int) -> list[tuple[tuple[int, ...], float]]:
    """Turns of `count` views, the first being 0, with the sums of their pairs' costs, cheapest first.

    View by view, of which only the most promising are continued: all of them for up to seven views.
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


def _upright(views: Sequence[View], turns: tuple[int, ...]) -> tuple[int, ...]:
    """The same order, numbered so that the last axis is the one that is most upright in the cameras' images."""
    up = np.mean([_up(view, turn) for view, turn in zip(views, turns, strict=True)], axis=0)
    shift = 2 - int(np.argmax(np.abs(up)))
    return tuple((turn + shift) % 3 for turn in turns)


def _up(view: View, turn: int) -> Floats:
    """The camera's up in the corner's frame, (3,)."""
    up: Floats = np.roll(view.axes @ np.array([0.0, -1.0, 0.0]), turn)
    return up


def _cost_of_tilt(a: View, b: View, turn: int) -> float:
    angle = np.arccos(np.clip(_up(a, 0) @ _up(b, turn), -1, 1))
    return float(0.5 * (angle / _UPRIGHT_SIGMA) ** 2)


@dataclass(frozen=True)
class _Patches:
    """One point (N, 3) for each patch, in the corner's frame; `off_walls` (N,): clearly before the three faces."""

    points: Floats
    off_walls: Bools


def _patches(view: View) -> _Patches:
    points = view.in_corner(view.points[view.there].astype(np.float64))
    size = _PATCH * view.distance
    _, first = np.unique(cells_of(points, size), return_index=True)
    return _Patches(points[first], np.min(np.abs(points[first]), axis=1) > size)


def cells_of(points: Floats, size: float) -> Ints:
    """A number for the cube of a grid with edges of `size` that each point (N, 3) is in, (N,)."""
    cell = np.floor(points / size).astype(np.int64) if len(points) else np.zeros((0, 3), np.int64)
    cell -= cell.min(axis=0, initial=0)
    extent = cell.max(axis=0, initial=0) + 1
    numbers: Ints = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
    return numbers


def _seen_by(view: View, patches: _Patches, turn: int) -> _Seen:
    """`turn`: that of the patches' corner relative to the view's."""
    points = view.in_camera(np.roll(patches.points, turn, axis=1))
    nearest, farthest, sees = depths_around(view, points)
    z = points[:, 2]
    through = sees & (nearest > (1 + _SAME_DEPTH) * z)
    meets = sees & ~through & (farthest > (1 - _SAME_DEPTH) * z)
    off = patches.off_walls
    return _Seen(int(through.sum()), int((through & off).sum()), int((meets & off).sum()))


def depths_around(view: View, points: Floats) -> tuple[Floats, Floats, Bools]:
    """Least and greatest depth that a view has in the 3 × 3 pixels around the images of points (N, 3) of its frame.

    And whether it has any there, (N,).
    """
    pixels = view.camera.project(points)
    with np.errstate(invalid="ignore"):
        sees = (points[:, 2] > 0) & np.all((pixels >= 0) & (pixels <= np.array(view.there.shape[::-1]) - 1.0), axis=1)
    column, row = np.rint(pixels[sees]).astype(np.int64).T
    height, width = view.there.shape
    around = np.stack(
        [
            view.points[np.clip(row + dy, 0, height - 1), np.clip(column + dx, 0, width - 1), 2]
            for dy, dx in product((-1, 0, 1), repeat=2)
        ]
    )
    nearest, farthest = np.full(len(points), np.nan), np.full(len(points), np.nan)
    nearest[sees] = np.fmin.reduce(around)
    farthest[sees] = np.fmax.reduce(around)
    return nearest, farthest, np.isfinite(nearest)


def _pictures_of_walls(view: View, pixel: float) -> list[tuple[Floats, Bools, Ints]] | None:
    """For each face what is painted on it, as a picture over its two other axes, where it is known, and its origin.

    Logarithms of the brightness, without what varies slowly: that is the light and not the paint.
    """
    if view.brightness is None or not view.there.any() or pixel == 0:
        return None
    points = view.in_corner(view.points[view.there].astype(np.float64))
    light = np.log(np.maximum(view.brightness[view.there].astype(np.float64), 1.0))
    pictures = []
    for face in range(3):
        on_wall = np.abs(points[:, face]) < _SAME_DEPTH * view.distance
        at = np.floor(points[on_wall][:, [(face + 1) % 3, (face + 2) % 3]] / pixel).astype(np.int64)
        origin = at.min(axis=0, initial=0)
        shape = tuple(at.max(axis=0, initial=0) - origin + 1)
        flat = np.ravel_multi_index(tuple((at - origin).T), shape)
        count = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)
        total = np.bincount(flat, light[on_wall], minlength=shape[0] * shape[1]).reshape(shape)
        known = count > 0
        picture = np.where(known, total / np.maximum(count, 1), 0.0)
        local = uniform_filter(picture, _WINDOW) / np.maximum(uniform_filter(known.astype(np.float64), _WINDOW), 1e-9)
        pictures.append((np.where(known, picture - local, 0.0), known, origin))
    return pictures


def _cost_of_paint(
    a: list[tuple[Floats, Bools, Ints]] | None, b: list[tuple[Floats, Bools, Ints]] | None, turn: int
) -> float:
    """−log likelihood of the correlation r of the walls' pictures: ½ n log(1 − r²), if r is positive."""
    if a is None or b is None:
        return 0.0
    products, count = np.zeros(3), 0
    for face in range(3):
        (first, known_first, from_first), (second, known_second, from_second) = a[(face + turn) % 3], b[face]
        low = np.maximum(from_first, from_second)
        high = np.minimum(from_first + first.shape, from_second + second.shape)
        if np.any(high <= low):
            continue
        in_first = tuple(slice(*ends) for ends in zip(low - from_first, high - from_first, strict=True))
        in_second = tuple(slice(*ends) for ends in zip(low - from_second, high - from_second, strict=True))
        both = known_first[in_first] & known_second[in_second]
        x, y = first[in_first][both], second[in_second][both]
        products += [x @ y, x @ x, y @ y]
        count += len(x)
    if not products[1] * products[2] > 0:
        return 0.0
    correlation = min(max(0.0, products[0] / np.sqrt(products[1] * products[2])), 0.99)
    return float(0.5 * count / _ALIKE_NEIGHBOURS * np.log(1 - correlation**2))
