"""Where the border of the projector's picture falls: the one thing in the light that moves along with the projector."""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.halves.tile_moments import centres_of_tiles, moments_of_tiles

# Decoded pixels so near to the border, in projector px, tell that it passes, within so many camera px.
_NEAR_PX = 6.0
_REACH_PX = 10
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


def near_border(projector_px: Floats32, size: tuple[int, int], step_px: float) -> Bools:
    """Where (H, W) the border of a picture of (width, height) may be seen, by the coordinates (H, W, 2) around it.

    These come in steps of `step_px`.
    """
    inside = np.minimum(projector_px, np.array(size, np.float32) - 1 - projector_px)
    return _around(inside.min(axis=2) < _NEAR_PX + step_px / 2)  # NaN is not


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
