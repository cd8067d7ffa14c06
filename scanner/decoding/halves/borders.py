"""Where the border of the projector's picture falls: the one thing in the light that moves along with the projector."""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.halves.tile_moments import TILE_PX, centres_of_tiles, moments_of_tiles

# Decoded pixels so near to the border, in projector px, tell that it passes, within so many camera px.
_NEAR_PX = 6.0
_REACH_PX = 10
# Planes go on for so many tiles beyond what is decoded: the border of a picture that moved is masked there.
_BEYOND_TILES = 3
_FLAT = 1e-3  # projector px per camera px
# The coordinates of a tile are those of a plane through its decoded pixels and its neighbours'.
_AROUND_TILES = 3
_FEWEST_PX = 100
_MOST_ROUGH_PX = 0.7
# So many times as rough as steps of one length make them, by chance.
_OF_STEPS = 1.5


@dataclass(frozen=True)
class Places:
    """Of T tiles: the projector's coordinates in their middles, `projector_px` (T, 2), and the `gradient` (T, 2, 2) of
    these (rows) by camera x and y; NaN where the coordinates are not smooth, or not known.
    """

    projector_px: Floats
    gradient: Floats


def seen_border(projector_px: Floats32, size: tuple[int, int], step_px: float) -> Bools:
    """Where (H, W) the border of a picture of (width, height) may be seen, by the coordinates (H, W, 2) around it.

    These come in steps of `step_px`.
    """
    inside = np.minimum(projector_px, np.array(size, np.float32) - 1 - projector_px)
    return _around(inside.min(axis=2) < _NEAR_PX + step_px / 2)  # NaN is not


def near_border(
    projector_px: Floats32, places: Places, moved_px: Floats, size: tuple[int, int], reach_px: float
) -> Bools:
    """Where (H, W) the border of a picture of (width, height) may be seen: within so many camera px of where it falls.

    By the coordinates (H, W, 2) without the `moved_px` (T, 2) of their tile; where unknown, by the planes of the tiles.
    """
    height, width, _ = projector_px.shape
    columns = width // TILE_PX
    found = np.zeros((height, width), np.bool_)
    last = np.array(size, np.float64) - 1
    steep = np.maximum(np.linalg.norm(places.gradient, axis=2), _FLAT)
    offset = np.stack(np.meshgrid(*[np.arange(TILE_PX) - (TILE_PX - 1) / 2] * 2), axis=-1)
    for row in range(height // TILE_PX):
        tiles = slice(row * columns, (row + 1) * columns)
        part = slice(row * TILE_PX, (row + 1) * TILE_PX), slice(0, columns * TILE_PX)
        seen = projector_px[part].reshape(TILE_PX, columns, TILE_PX, 2).transpose(1, 0, 2, 3)
        at_centre, beside, slopes = (of_tiles[tiles, None, None] for of_tiles in (places.projector_px, moved_px, steep))
        of_planes = at_centre + np.einsum("tac,yxc->tyxa", places.gradient[tiles], offset)
        place = np.where(np.isfinite(seen).all(axis=3, keepdims=True), seen, of_planes) - beside
        inside_px = (np.minimum(place, last - place) / slopes).min(axis=3)
        found[part] = (np.abs(inside_px) < reach_px).transpose(1, 0, 2).reshape(TILE_PX, -1)  # NaN is not
    return found


def lit_in(projector_px: Floats32) -> Bools:
    """Where (H, W) the projector's light falls, by the coordinates (H, W, 2) that are known."""
    return _around(_known(projector_px))


def _known(projector_px: Floats32) -> Bools:
    return np.isfinite(projector_px[..., 0]) & np.isfinite(projector_px[..., 1])


def _around(pixels: Bools) -> Bools:
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _REACH_PX + 1,) * 2)
    return cv2.dilate(pixels.astype(np.uint8), disc).astype(np.bool_)


def places_of_tiles(projector_px: Floats32, step_px: float) -> Places:
    """From the coordinates (H, W, 2) of all camera pixels, in steps of `step_px`, NaN where unknown."""
    height, width, _ = projector_px.shape
    known = _known(projector_px)
    # Relative to the middle of the image, for the sake of rounding.
    x = np.broadcast_to(np.arange(width, dtype=np.float32) - width / 2, known.shape)
    y = np.broadcast_to((np.arange(height, dtype=np.float32) - height / 2)[:, None], known.shape)
    moments = moments_of_tiles([np.ones_like(x), x, y, projector_px[..., 0], projector_px[..., 1]], known)
    around = cv2.boxFilter(
        moments.reshape(*moments.shape[:2], -1),
        -1,
        (_AROUND_TILES,) * 2,
        normalize=False,
        borderType=cv2.BORDER_CONSTANT,
    ).reshape(-1, 5, 5)
    planes = np.linalg.solve(around[:, :3, :3] + 1e-6 * np.eye(3), around[:, :3, 3:])
    left = np.trace(around[:, 3:, 3:] - around[:, 3:, :3] @ planes, axis1=1, axis2=2)
    count = around[:, 0, 0]
    smooth = (count >= _FEWEST_PX) & (left < (_MOST_ROUGH_PX**2 + 2 * _OF_STEPS * step_px**2 / 12) * count)
    smooth_planes: Floats = np.where(smooth[:, None, None], planes, np.nan)
    offset = centres_of_tiles(known.shape).reshape(-1, 2) - np.array([width, height]) / 2
    at_centre: Floats = smooth_planes[:, 0] + np.einsum("ta,tac->tc", offset, smooth_planes[:, 1:])
    return Places(at_centre, smooth_planes[:, 1:].transpose(0, 2, 1))


def going_on(places: Places, shape: tuple[int, ...]) -> Places:
    """The same of an image of `shape` (H, W): tiles beside those that are known have the plane of the nearest one."""
    rows, columns = (size // TILE_PX for size in shape)
    unknown = ~np.isfinite(places.gradient).all(axis=(1, 2))
    if unknown.all():
        return places
    far, label = cv2.distanceTransformWithLabels(
        unknown.reshape(rows, columns).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(label.max()) + 1, np.int64)
    known = np.flatnonzero(~unknown)
    of_label[label.reshape(-1)[known]] = known
    nearest = of_label[label.reshape(-1)]
    gradient = places.gradient[nearest]
    centre = centres_of_tiles(shape).reshape(-1, 2)
    projector_px = places.projector_px[nearest] + np.einsum("tac,tc->ta", gradient, centre - centre[nearest])
    beyond = far.reshape(-1) > _BEYOND_TILES
    projector_px[beyond], gradient[beyond] = np.nan, np.nan
    return Places(projector_px, gradient)
