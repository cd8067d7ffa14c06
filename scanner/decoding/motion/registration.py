"""Registration of two pictures of a scene, tile by tile, from their gradients (Lucas and Kanade, IJCAI 1981).

For each tile, the shift d explains the difference of the pictures, D = g M + o − ∇M · d, with a gain g and an offset o.
M is the mean of both pictures, so that features of one of them alone, such as fringe ripple, cause no shift. The
coordinates of a tile's pixels lie in a plane.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import LEVEL, SLOPE, Bools, Floats, Floats32, Ints, compiled
from scanner.decoding.significance import FEWEST_PIXELS, NEGLIGIBLE

TILE_PX = 16  # side of a tile, over which the shift is taken as constant
_OF_LIGHT, _OF_SHIFT = 2, 2  # unknowns of a tile: g and o, and d
# Largest rms distance from a plane, in projector px: tiles on edges or curved surfaces are rejected.
MOST_ROUGH_PX = 0.7
# A tile's plane is fitted to its own decoded pixels and its neighbours', in a window of this size, and extrapolated as
# many tiles beyond decoded ones: there the border of a picture that moved is masked.
AROUND_TILES = 3
_REACH = 2  # taps of the filters to either side
_WINDOW = TILE_PX + 2 * _REACH


@dataclass(frozen=True)
class TileWarp:
    """Where T tiles are in the later picture: their middles at `place` (T, 2), and their surroundings `turned` (2, 2)
    about these.
    """

    place: Floats
    turned: Floats


@dataclass(frozen=True)
class TileShifts:
    """Observations of the shifts d of K tiles, each as two independent equations `slopes` · d = `seen`, in standard
    deviations.
    """

    tiles: Ints
    """(K,): their numbers."""
    slopes: Floats
    """(K, 2, 2)"""
    seen: Floats
    """(K, 2)"""
    differ: float
    """The squared differences of the pictures, weighted by their squared slopes."""


def centres_of_tiles(shape: tuple[int, ...]) -> Floats:
    """Return the middles (T, 2), x and y, of the tiles of an image of `shape` (H, W), row by row."""
    rows, columns = (np.arange(size // TILE_PX, dtype=np.float64) for size in shape)
    return (np.stack(np.meshgrid(columns, rows), axis=-1) * TILE_PX + (TILE_PX - 1) / 2).reshape(-1, 2)


@dataclass(frozen=True)
class TilePlanes:
    """Coordinates of T tiles: `projector_px` (T, 2) in their middles, and the `gradient` (T, 2, 2) by camera x and y.

    NaN where the coordinates are unknown or not smooth.
    """

    projector_px: Floats
    gradient: Floats

    @property
    def known(self) -> Bools:
        """(T,): the tiles that have a plane."""
        return np.asarray(np.isfinite(self.gradient).all(axis=(1, 2)), np.bool_)

    def extrapolated(self, shape: tuple[int, ...]) -> "TilePlanes":
        """Return these planes, and those of the nearest known tiles for the unknown ones of an image (H, W)."""
        rows, columns = (size // TILE_PX for size in shape)
        known = self.known
        if not known.any():
            return self
        far, label = cv2.distanceTransformWithLabels(
            (~known).reshape(rows, columns).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
        )
        of_label = np.zeros(int(label.max()) + 1, np.int64)
        of_label[label.reshape(-1)[known]] = np.flatnonzero(known)
        nearest = of_label[label.reshape(-1)]
        gradient, centre = self.gradient[nearest], centres_of_tiles(shape)
        projector_px = self.projector_px[nearest] + np.einsum("tac,tc->ta", gradient, centre - centre[nearest])
        beyond = far.reshape(-1) > AROUND_TILES
        projector_px[beyond], gradient[beyond] = np.nan, np.nan
        return TilePlanes(projector_px, gradient)


def planes_of_tiles(projector_px: Floats32, step_px: float) -> TilePlanes:
    """Fit planes to the coordinates (H, W, 2) of all camera pixels, in steps of `step_px`, NaN where unknown."""
    shape = projector_px.shape[:2]
    rows, columns = (size // TILE_PX for size in shape)
    moments = np.zeros((rows, columns, 5, 5))
    _sum_coordinate_products(projector_px, moments)
    window = (AROUND_TILES, AROUND_TILES)
    moments = cv2.boxFilter(
        moments.reshape(rows, columns, -1), -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT
    ).reshape(-1, 5, 5)
    planes = np.linalg.solve(moments[:, :3, :3] + 1e-6 * np.eye(3), moments[:, :3, 3:])
    squares = np.trace(moments[:, 3:, 3:] - moments[:, 3:, :3] @ planes, axis1=1, axis2=2)
    count = moments[:, 0, 0]
    smooth = (count >= FEWEST_PIXELS) & (squares < (MOST_ROUGH_PX**2 + 2 * step_px**2 / 12) * count)
    smooth_planes: Floats = np.where(smooth[:, None, None], planes, np.nan)
    offset = centres_of_tiles(shape) - np.array(shape[::-1]) / 2
    at_centre: Floats = smooth_planes[:, 0] + np.einsum("ta,tac->tc", offset, smooth_planes[:, 1:])
    return TilePlanes(at_centre, smooth_planes[:, 1:].transpose(0, 2, 1))


def shifts_of_tiles(
    pictures: tuple[Floats32, Floats32],
    labels: NDArray[np.uint8],
    label: int,
    warp: TileWarp,
    tiles: Ints,
    *,
    own_light: bool = True,
) -> TileShifts:
    """Observe the shifts of some tiles (K,) from the pixels with a `label` (H, W) of two pictures, the later one warped
    back.

    The pictures may be reduced by a whole number. `own_light`: whether g and o are fitted. They would absorb an edge
    that is blurred over more than a tile.
    """
    before, after = pictures
    step = len(labels) // len(before)
    moments = np.zeros((len(tiles), 5, 5))
    # Levels are relative to one of the picture, to limit rounding errors.
    level = np.float32(before[TILE_PX // 2 :: TILE_PX, TILE_PX // 2 :: TILE_PX].mean())
    taps = np.stack([LEVEL, SLOPE]).astype(np.float32)
    place, chosen = (warp.place + 0.5) / step - 0.5, labels[::step, ::step] == label
    _sum_moments(before, after, chosen, tiles, TILE_PX // step, place, warp.turned, taps, level, moments)
    in_pixels = step * np.array([1.0, 1.0, 1 / step, 1 / step, 1.0])
    moments *= np.outer(in_pixels, in_pixels)
    filled = moments[:, 0, 0] > _OF_LIGHT + _OF_SHIFT
    tiles, moments = tiles[filled], moments[filled]
    slopes, seen = _equations(moments, own_light=own_light)
    tells = np.abs(slopes).max(axis=(1, 2)) > 0
    count, steepness, differ = moments[:, 0, 0], moments[:, 2, 2] + moments[:, 3, 3], moments[:, 4, 4]
    return TileShifts(tiles[tells], slopes[tells], seen[tells], float(np.sum(steepness * differ / count)))


def _equations(moments: Floats, *, own_light: bool) -> tuple[Floats, Floats]:
    """Return the slopes (T, 2, 2) and what is seen (T, 2), from the moments (T, 5, 5) of 1, M, −∇M and D."""
    count, rest = moments[:, 0, 0], moments[:, 2:, 2:]
    parameters = _OF_SHIFT
    if own_light:
        parameters += _OF_LIGHT
        root = _inverse_root(moments[:, :2, :2])
        by_light = root @ moments[:, :2, 2:]
        rest = rest - by_light.transpose(0, 2, 1) @ by_light
    normal, root = rest[:, :2, :2], _inverse_root(rest[:, :2, :2])
    slopes, seen = root @ normal, np.einsum("tab,tb->ta", root, rest[:, :2, 2])
    variance = np.maximum(rest[:, 2, 2] - np.sum(seen**2, axis=1), 0.0) / (count - parameters)
    # The residual variance of a tile is at least the median of all, since a low one is due to chance.
    least = float(np.median(variance)) if len(variance) else 0.0
    sigma = np.sqrt(np.maximum(variance, max(least, 1e-9)))
    return slopes / sigma[:, None, None], seen / sigma[:, None]


def _inverse_root(matrices: Floats) -> Floats:
    """Return R (T, 2, 2) with RᵀR the inverses of symmetric matrices that may be singular, with a small regularisation
    (Cholesky).
    """
    across, both, down = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    little = NEGLIGIBLE * np.maximum(across + down, 0.0) + 1e-12
    first = 1 / np.sqrt(np.maximum(across, 0.0) + little)
    second = 1 / np.sqrt(np.maximum(down + little - (both * first) ** 2, little))
    root = np.zeros_like(matrices)
    root[:, 0, 0], root[:, 1, 1], root[:, 1, 0] = first, second, -both * first**2 * second
    return root


@compiled
def _sum_products(values: Floats, count: int, sums: Floats) -> None:
    """Fill the sums of products (N, N) of N lists (N, K), of which the first `count` entries count."""
    for a in range(len(values)):
        for b in range(a + 1):
            total = 0.0
            for k in range(count):
                total += values[a, k] * values[b, k]
            sums[a, b] = sums[b, a] = total


@compiled
def _sum_moments(
    before: Floats32,
    after: Floats32,
    chosen: Bools,
    tiles: Ints,
    tile_px: int,
    place: Floats,
    turned: Floats,
    taps: Floats32,
    usual: np.float32,
    moments: Floats,
) -> None:
    """Fill the moments (K, 5, 5) of 1, M, −∇M and D over the chosen pixels of each of some tiles (K,)."""
    columns = before.shape[1] // tile_px
    # As large as for whole tiles: loops of constant length are several times as fast.
    around = np.empty((_WINDOW + 1, _WINDOW + 1), np.float32)
    mean, difference = np.empty((_WINDOW, _WINDOW), np.float32), np.empty((_WINDOW, _WINDOW), np.float32)
    across = np.empty((3, _WINDOW, TILE_PX), np.float32)
    filtered = np.empty((4, TILE_PX, TILE_PX), np.float32)
    values = np.empty((5, tile_px * tile_px))
    for number in range(len(tiles)):
        tile = tiles[number]
        top, left = tile // columns * tile_px, tile % columns * tile_px
        if not chosen[top : top + tile_px, left : left + tile_px].any():
            continue
        _sample(before, after, top, left, tile_px, place[tile], turned, around, mean, difference)
        _filter(mean, difference, taps, usual, across, filtered)
        count = 0
        for y in range(tile_px):
            for x in range(tile_px):
                if chosen[top + y, left + x]:
                    values[0, count] = 1.0
                    for a in range(4):
                        values[1 + a, count] = filtered[a, y, x]
                    count += 1
        _sum_products(values, count, moments[number])


@compiled
def _sample(
    before: Floats32,
    after: Floats32,
    top: int,
    left: int,
    tile_px: int,
    place: Floats,
    turned: Floats,
    around: Floats32,
    mean: Floats32,
    difference: Floats32,
) -> None:
    """Sample mean and difference of the pictures in a tile and its margin; beyond the border, its pixels repeat.

    The later picture is interpolated linearly, between the neighbours `around` that the pixels have in a tile that is
    not turned: cubic interpolation shifts ramps by up to 0.05 px.
    """
    height, width = before.shape
    middle = np.float32((tile_px - 1) / 2 + _REACH)
    u, v = int(np.floor(place[0] - middle)), int(np.floor(place[1] - middle))
    for y in range(_WINDOW + 1):
        row = min(max(v + y, 0), height - 1)
        for x in range(_WINDOW + 1):
            around[y, x] = after[row, min(max(u + x, 0), width - 1)]
    right, down = np.float32(place[0] - middle - u), np.float32(place[1] - middle - v)
    zoom, roll = np.float32(turned[0, 0] - 1), np.float32(turned[1, 0])
    for y in range(_WINDOW):
        row = min(max(top + y - _REACH, 0), height - 1)
        for x in range(_WINDOW):
            mean[y, x] = before[row, min(max(left + x - _REACH, 0), width - 1)]
        for x in range(_WINDOW):
            further, lower = np.float32(x) - middle, np.float32(y) - middle
            across = right + zoom * further - roll * lower
            upper_level = around[y, x] + across * (around[y, x + 1] - around[y, x])
            lower_level = around[y + 1, x] + across * (around[y + 1, x + 1] - around[y + 1, x])
            later = upper_level + (down + roll * further + zoom * lower) * (lower_level - upper_level)
            difference[y, x] = later - mean[y, x]
            mean[y, x] = np.float32(0.5) * (mean[y, x] + later)


@compiled
def _filter(
    mean: Floats32, difference: Floats32, taps: Floats32, usual: np.float32, across: Floats32, filtered: Floats32
) -> None:
    """Fill the level of the mean, relative to the `usual` one, −∇ of the mean, and the level of the difference."""
    for y in range(_WINDOW):
        for x in range(TILE_PX):
            level, slope, change = np.float32(0), np.float32(0), np.float32(0)
            for k in range(2 * _REACH + 1):
                level += taps[0, k] * (mean[y, x + k] - usual)
                slope += taps[1, k] * mean[y, x + k]
                change += taps[0, k] * difference[y, x + k]
            across[0, y, x], across[1, y, x], across[2, y, x] = level, slope, change
    for y in range(TILE_PX):
        for x in range(TILE_PX):
            level, by_x, by_y, change = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for k in range(2 * _REACH + 1):
                level += taps[0, k] * across[0, y + k, x]
                by_x += taps[0, k] * across[1, y + k, x]
                by_y += taps[1, k] * across[0, y + k, x]
                change += taps[0, k] * across[2, y + k, x]
            filtered[0, y, x], filtered[1, y, x] = level, -by_x
            filtered[2, y, x], filtered[3, y, x] = -by_y, change


@compiled
def _sum_coordinate_products(projector_px: Floats32, moments: Floats) -> None:
    """Fill the sums (rows, columns, 5, 5) over the known pixels (H, W, 2) of each tile of products of 1, the pixel's
    column and row from the middle of the image, and its coordinates.
    """
    rows, columns, _, _ = moments.shape
    height, width, _ = projector_px.shape
    values = np.empty((5, TILE_PX * TILE_PX))
    for row in range(rows):
        for column in range(columns):
            filled = 0
            for y in range(row * TILE_PX, (row + 1) * TILE_PX):
                for x in range(column * TILE_PX, (column + 1) * TILE_PX):
                    across, down = projector_px[y, x, 0], projector_px[y, x, 1]
                    if across == across and down == down:
                        values[0, filled], values[1, filled], values[2, filled] = 1.0, x - width / 2, y - height / 2
                        values[3, filled], values[4, filled] = across, down
                        filled += 1
            if filled:
                _sum_products(values, filled, moments[row, column])
