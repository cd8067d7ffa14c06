"""How far the parts of one picture of a scene lie beside those of another, from their gradients.

For each small tile the shift d that explains the difference of two pictures, D = g M + o − ∇M · d, with a brightness g
and an offset o of its own (Lucas and Kanade, IJCAI 1981). M is the mean of both pictures: what is in one of them only,
say ripple of its fringes, then moves nothing.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.halves.tile_moments import centres_of_tiles, moments_of_tiles
from scanner.decoding.slopes import LEVEL, SLOPE

_FEWEST_PX = 24
_OF_LIGHT, _OF_SHIFT = 2, 2
_SINGULAR = 1e-6


@dataclass(frozen=True)
class TileShifts:
    """What T tiles say of their shift d: it minimises dᵀ N d − 2 bᵀ d, in units of the variance of what is left.

    `centre_px` (T, 2), `normal` N (T, 2, 2), `pull` b (T, 2). Of tiles that say nothing, both are 0.
    """

    centre_px: Floats
    normal: Floats
    pull: Floats


def shifts_of_tiles(
    before: Floats32, after: Floats32, chosen: Bools, blur_px: float, *, own_light: bool = True
) -> TileShifts:
    """From the `chosen` pixels (H, W) of two pictures (H, W), of which `after` is the later one, blurred beforehand.

    Without g and o (`own_light`): these take an edge that is blurred more widely than a tile for light.
    """
    if blur_px:
        before, after = (np.asarray(cv2.GaussianBlur(one, (0, 0), blur_px), np.float32) for one in (before, after))
    mean = before + after
    mean *= np.float32(0.5)
    mean -= np.float32(mean.mean())
    level, by_x, by_y = (_filtered(mean, *taps) for taps in ((LEVEL, LEVEL), (SLOPE, LEVEL), (LEVEL, SLOPE)))
    difference = _filtered(after - before, LEVEL, LEVEL)
    moments = moments_of_tiles([np.ones_like(level), level, -by_x, -by_y, difference], chosen).reshape(-1, 5, 5)
    return TileShifts(centres_of_tiles(mean.shape).reshape(-1, 2), *_of_moments(moments, own_light=own_light))


def _filtered(picture: Floats32, across: Floats, down: Floats) -> Floats32:
    return np.asarray(cv2.sepFilter2D(picture, cv2.CV_32F, across, down), np.float32)


def _of_moments(moments: Floats, *, own_light: bool) -> tuple[Floats, Floats]:
    """N and b from the moments (T, 5, 5) of 1, M, −∇M and D."""
    count, rest = moments[:, 0, 0], moments[:, 2:, 2:]
    parameters = _OF_SHIFT
    if own_light:
        parameters += _OF_LIGHT
        rest = rest - moments[:, 2:, :2] @ _solved(moments[:, :2, :2], moments[:, :2, 2:])
    normal, pull = rest[:, :2, :2], rest[:, :2, 2]
    left = rest[:, 2, 2] - np.einsum("ta,ta->t", pull, _solved(normal, pull[..., None])[..., 0])
    enough = count >= _FEWEST_PX
    variance = np.maximum(left, 0.0) / np.maximum(count - parameters, 1)
    # What is left of a tile by chance is not less than what is left of most.
    variance = np.maximum(variance, max(float(np.median(variance[enough])) if enough.any() else 0.0, 1e-9))
    precision = enough / variance
    return normal * precision[:, None, None], pull * precision[:, None]


def _solved(matrices: Floats, right: Floats) -> Floats:
    """Least squares with square matrices (T, 2, 2) that may be singular."""
    size = np.trace(matrices, axis1=1, axis2=2)[:, None, None]
    solved: Floats = np.linalg.solve(matrices + (_SINGULAR * size + 1e-12) * np.eye(2), right)
    return solved
