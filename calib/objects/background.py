"""The static background of a thing that moves in front of a static rig: table, cloth, wall, and rotationally symmetric
plates.

The background is behind the thing, and has the same depth in many stations. Where the thing hides it from most of them,
points in the plane of a table or a wall count as background as well.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats

FEWEST = 4  # stations; fewer agree by chance, except on planes
_SHARE = 0.3  # share of the stations that see anything at a pixel
_QUANTILE = 0.85  # quantile of their depths: within the farthest third
_WITHIN, _SIGMAS = 3e-4, 5.0  # largest difference of equal depths, relative, and in sigmas of the noise
_OPENED = 5  # size of the morphological opening, in pixels
# Planes: number to find, sampled points per station, least share of the remaining points, trials per plane; and a
# factor on the depth tolerance, because calibration errors bend planes.
_PLANES, _POINTS, _OF_PLANE, _TRIALS, _LOOSELY = 3, 400, 0.25, 300, 3.0


def resting_depth(depths: Sequence[NDArray[np.float32]], noise: Sequence[float]) -> NDArray[np.float32]:
    """Depths (H, W) of the background, 0 elsewhere, from the stations' (H, W), NaN for none.

    `noise`: standard deviation of a depth z is `noise` · z². With fewer than FEWEST stations, all must agree.
    """
    stack = np.stack(depths)
    counts = np.count_nonzero(np.isfinite(stack), axis=0)
    order = np.sort(stack, axis=0)  # NaN last
    index = np.floor(_QUANTILE * np.maximum(counts - 1, 0)).astype(np.int64)
    far = np.take_along_axis(order, index[None], axis=0)[0]
    near = within(stack, far, float(np.median(noise)))
    agreeing = np.count_nonzero(near, axis=0)
    rests = (agreeing >= np.maximum(_SHARE * counts, min(FEWEST - 1, len(depths)))) & (counts >= _SHARE * len(depths))
    square = np.ones((_OPENED, _OPENED), np.uint8)
    opened = cv2.morphologyEx(rests.astype(np.uint8), cv2.MORPH_OPEN, square) > 0
    mean = np.sum(np.where(near, stack, 0), axis=0) / np.maximum(agreeing, 1)
    return np.where(opened, mean, 0).astype(np.float32)


def within(
    depth: NDArray[np.float32], rest: NDArray[np.float32], noise: float, loosely: float = 1.0
) -> NDArray[np.bool_]:
    """Whether a depth is that of the background, and not of something in front of it."""
    with np.errstate(invalid="ignore"):
        at_rest: NDArray[np.bool_] = np.abs(depth - rest) < loosely * rest * (_WITHIN + _SIGMAS * noise * rest)
    return at_rest


def resting_planes(resting: Sequence[NDArray[np.float32]], noise: float) -> list[Floats]:
    """Planes n (3,), n · X = 1, with a large share of the `resting` points (N, 3) of all stations, by RANSAC."""
    rng = np.random.default_rng(0)
    remaining = np.concatenate([rng.permutation(points)[:_POINTS] for points in resting]).astype(np.float64)
    planes: list[Floats] = []
    least = _OF_PLANE * len(remaining)
    while len(planes) < _PLANES and len(remaining) >= max(least, 3):
        chosen = remaining[rng.integers(0, len(remaining), (_TRIALS, 3))]
        sound = np.abs(np.linalg.det(chosen)) > 0
        trials = np.linalg.solve(chosen[sound], np.ones((np.count_nonzero(sound), 3, 1)))[..., 0]
        on_it = _on(remaining, trials, noise) if len(trials) else np.zeros((0, len(remaining)), np.bool_)
        best = on_it[np.argmax(np.count_nonzero(on_it, axis=1))] if len(on_it) else np.zeros(len(remaining), np.bool_)
        if np.count_nonzero(best) < least:
            break
        plane = np.linalg.lstsq(remaining[best], np.ones(np.count_nonzero(best)), rcond=None)[0]
        planes.append(plane)
        remaining = remaining[~_on(remaining, plane[None], noise)[0]]
    return planes


def in_planes(points: NDArray[np.float32], planes: Sequence[Floats], noise: float) -> NDArray[np.bool_]:
    """Which points (H, W, 3), NaN for none, lie in one of the planes, (H, W)."""
    on_planes = np.zeros(points.shape[:2], np.bool_)
    for plane in planes:
        on_planes |= _on(points.reshape(-1, 3), plane[None], noise)[0].reshape(on_planes.shape)
    return on_planes


def _on(points: NDArray[np.floating], planes: Floats, noise: float) -> NDArray[np.bool_]:
    """Which points (N, 3) lie in each of K planes (K, 3), (K, N): by the depth of the plane on their ray."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = planes @ points.T
        return within(points[:, 2], np.where(ahead > 0, points[:, 2] / ahead, np.nan), noise, _LOOSELY)
