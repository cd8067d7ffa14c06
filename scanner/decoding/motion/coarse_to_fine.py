"""Coarse-to-fine registration of two pictures of the evenly lit scene, and the time of the change between them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from math import log, sqrt

import cv2
import numpy as np

from calib.numerics import Floats, Floats32, Image, clustered_scatter, huber_weights
from scanner.decoding.motion.borders import REACH_PX, Edges, ScenePixels
from scanner.decoding.motion.device_motion import SUSPECTED_PX
from scanner.decoding.motion.pixels import COLUMNS, PER_DEVICE, RigidFit
from scanner.decoding.motion.registration import shifts_of_tiles, solved
from scanner.decoding.significance import (
    HALF,
    HUBER_ROUNDS,
    HUBER_SIGMAS,
    NEGLIGIBLE,
    SIGNIFICANT_SIGMAS,
)

# A picture with at least this share of the change, and of the rest, was taken during it. With less, a camera that
# turned before the finest bits would have turned by a part of it during them.
_PARTLY = 0.25


@dataclass(frozen=True)
class TimeOfChange:
    """The completed share `done` (K,) of a change in each of K pictures.

    `gained`: ratio of the explained difference to that of a change at the given place.
    """

    done: Floats
    gained: float

    @property
    def before(self) -> tuple[int, ...]:
        """Numbers of the pictures before the change."""
        return tuple(np.flatnonzero(self.done == 0).tolist())

    @property
    def after(self) -> tuple[int, ...]:
        """Numbers of the pictures after it."""
        return tuple(np.flatnonzero(self.done == 1).tolist())


def time_of_change(pictures: Image, first: int, stripes: Sequence[float]) -> TimeOfChange | None:
    """Locate a single change of K pictures (K, P), compared with a change after the `first` few.

    `stripes`: stripe width of the pair that each picture is the sum of. None if sorting the pictures by stripe width
    separates them better than sorting by time: stripes that were sharpened or rescaled do not add up to even light. A
    change of overall brightness is ignored.
    """
    levels = pictures.astype(np.float64)
    mean = levels.mean(axis=0)
    light = np.stack([np.ones_like(mean), mean])
    levels -= levels @ np.linalg.pinv(light) @ light  # the mean may be even itself
    count = len(levels)
    products = levels @ levels.T
    between = _between_groups(products)
    by_width = np.argsort(stripes, kind="stable")
    if between.max() < _between_groups(products[np.ix_(by_width, by_width)]).max():
        return None
    best = int(np.argmax(between)) + 1
    # Either picture next to the change may have been taken during it.
    before, after = (part.mean(axis=0) for part in (levels[: max(best - 1, 1)], levels[min(best + 1, count - 1) :]))
    change = after - before
    done = (levels @ change - before @ change) / max(float(change @ change), 1e-12)
    shares = (np.arange(count) >= best).astype(np.float64)
    at_change = np.array([number for number in (best - 1, best) if 0 < number < count - 1], np.int64)
    partly = at_change[np.abs(done[at_change] - 0.5) < 0.5 - _PARTLY]
    shares[partly] = done[partly]
    return TimeOfChange(shares, float(between[best - 1] / max(between[first - 1], 1e-12)))


def _between_groups(products: Floats) -> Floats:
    """Return the sum of squares between the groups, (K - 1,), for each split of a list in two.

    `products` (K, K): scalar products of the list's members, whose sum is 0.
    """
    count = len(products)
    splits = np.arange(1, count)
    sums = np.diagonal(np.cumsum(np.cumsum(products, axis=0), axis=1))[:-1]
    between: Floats = sums * count / (splits * (count - splits))
    return between


# Systematic error from fringe ripple and fixed patterns, in captures of real devices at rest.
_SYSTEMATIC_PX = 0.01
# Prior standard deviations: a bump turns a device; it hardly rolls it, and does not change its zoom.
_EXPECTED_PX = SUSPECTED_PX * np.tile([1.0, 1.0, 0.3, 0.3], 2)
# Blurs of the coarse-to-fine fit of a motion that is large compared with the sharpness of edges.
_COARSE_TO_FINE_PX = (6.0, 3.0, 1.5, 0.0, 0.0)
# A motion that is small compared with it, and the last step of a fit that has converged.
_SMALL_PX = 0.2
# The border is searched for within this many camera px of its predicted place; more where the prediction is uncertain,
# plus this multiple of the blur. Everything outside is scene.
_REACH_PX, _REACH_OF_BLUR = 4.0, 2.0
# Tiles within squares of this side, four by four, may have correlated errors.
_GROUP_PX = 64
_AT_REST = np.zeros(COLUMNS)

_Pictures = tuple[Floats32, Floats32]


@dataclass(frozen=True)
class _TileObservations:
    """Shifts d of T tiles that remain beside a motion: they minimise dᵀ N d − 2 bᵀ d."""

    centre_px: Floats
    """(T, 2): middles in the camera's picture."""
    design: Floats
    """(T, 2, 8): derivatives of d by the motion."""
    normal: Floats
    """(T, 2, 2): N."""
    pull: Floats
    """(T, 2): b."""
    differ: float
    """Squared differences of the pictures, weighted by their squared slopes."""
    huber: float
    """Outlier threshold in standard deviations."""


@dataclass(frozen=True)
class _Scales:
    """The earlier and the later picture, `blurred` by a number of px, and the observations without motion.

    `at_rest`: at full resolution; `coarsely`: at the largest blur.
    """

    blurred: Callable[[float], _Pictures]
    at_rest: _TileObservations
    coarsely: _TileObservations


def motion_of(pictures: _Pictures, edges: Edges) -> RigidFit:
    """Return the motion from the earlier picture to the later one, of one device if the other has hardly moved."""
    blurred = cache(partial(_blurred, pictures))
    coarsely = _observe_beside(blurred, edges, _AT_REST, _COARSE_TO_FINE_PX[0])
    scales = _Scales(blurred, _observe(pictures, edges, edges.decoded, _AT_REST), coarsely)
    fit = _measured(scales, edges, _EXPECTED_PX)
    devices = np.split(np.arange(COLUMNS), [PER_DEVICE])
    sure = [
        replace(fit, motion=fit.motion[columns], covariance=fit.covariance[np.ix_(columns, columns)])
        for columns in devices
    ]
    less, more = sorted((0, 1), key=lambda device: sure[device].significance)
    if not sure[less].significance < SIGNIFICANT_SIGMAS < sure[more].significance:
        return fit
    expected_px = _EXPECTED_PX.copy()
    expected_px[devices[less]] = NEGLIGIBLE
    return replace(fit, motion=_measured(scales, edges, expected_px).motion)


def _measured(scales: _Scales, edges: Edges, expected_px: Floats) -> RigidFit:
    """Fit the motion, coarse to fine if it is large: of both devices if that is reliable, else of the camera alone."""
    fit = _least_squares(scales.at_rest, expected_px)
    step = _least_squares(scales.coarsely, expected_px)
    largest_px = float(np.abs(fit.motion).max())
    if max(largest_px, float(np.abs(step.motion).max())) < _SMALL_PX:
        return fit
    motion = step.motion
    for blur_px in _COARSE_TO_FINE_PX[1:]:
        step = _least_squares(_observe_beside(scales.blurred, edges, motion, blur_px), expected_px)
        motion = motion + step.motion
    # Without texture it finds spurious motion, which explains little of the differences at edges.
    if np.abs(step.motion).max() < _SMALL_PX and _explained(scales.blurred(0.0), edges, motion) > HALF:
        return replace(step, motion=motion)
    if largest_px < _SMALL_PX:
        return fit
    camera = _AT_REST.copy()
    for blur_px in _COARSE_TO_FINE_PX:
        fit = _least_squares(_observe(scales.blurred(blur_px), edges, edges.decoded, camera), expected_px)
        camera[PER_DEVICE:] += fit.motion[PER_DEVICE:]
    return replace(fit, motion=np.concatenate([fit.motion[:PER_DEVICE], camera[PER_DEVICE:]]))


def _blurred(pictures: _Pictures, blur_px: float) -> _Pictures:
    """Return the pictures (H, W) or, blurred, at half their size."""
    if not blur_px:
        return pictures
    before, after = (_halved(picture, blur_px) for picture in pictures)
    return before, after


def _halved(picture: Floats32, blur_px: float) -> Floats32:
    half = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(half, (0, 0), blur_px / 2), np.float32)


def _observe_beside(
    blurred: Callable[[float], _Pictures], edges: Edges, motion: Floats, blur_px: float
) -> _TileObservations:
    """Observe what remains beside a motion (8,) at a blur, with the border where the planes predict it.

    While the border is uncertain, no tile is down-weighted: most of the border may run along the motion.
    """
    reach_px = REACH_PX + _REACH_OF_BLUR * blur_px if blur_px else _REACH_PX
    return _observe(blurred(blur_px), edges, edges.beside(motion, reach_px), motion, anywhere=blur_px > 0)


def _explained(pictures: _Pictures, edges: Edges, motion: Floats) -> float:
    """Return the share of the squared difference of the pictures (H, W) at edges that a motion (8,) explains."""
    pixels = edges.beside(motion, _REACH_PX)
    remaining, differ = (_observe(pictures, edges, pixels, of).differ for of in (motion, _AT_REST))
    return 1 - remaining / max(differ, 1e-12)


def _observe(
    pictures: _Pictures, edges: Edges, pixels: ScenePixels, motion: Floats, *, anywhere: bool = False
) -> _TileObservations:
    """Observe what remains beside a motion (8,); a border that may be `anywhere` has no gain of its own, and no
    outliers.
    """
    of_scene, of_border = edges.warps(motion)
    scene = shifts_of_tiles(pictures, pixels.scene, of_scene)
    border = shifts_of_tiles(pictures, pixels.border, of_border, own_light=not anywhere)
    known = np.isfinite(pixels.of_border[border.tiles]).all(axis=(1, 2))
    at_border = border.tiles[known]
    return _TileObservations(
        edges.centre[np.concatenate([scene.tiles, at_border])],
        np.concatenate([edges.of_scene[scene.tiles], pixels.of_border[at_border]]),
        np.concatenate([scene.normal, border.normal[known]]),
        np.concatenate([scene.pull, border.pull[known]]),
        scene.differ + border.differ,
        np.inf if anywhere else HUBER_SIGMAS,
    )


def _least_squares(tiles: _TileObservations, expected_px: Floats) -> RigidFit:
    """Fit the motion (8,) by robust least squares, with a prior for unobservable parts."""
    design = tiles.design
    expected = np.diag(1 / expected_px**2)
    by_motion = tiles.normal @ design
    weight = np.ones(len(design))
    for _ in range(HUBER_ROUNDS):
        weighted = (weight[:, None, None] * design).reshape(-1, COLUMNS).T
        information = weighted @ by_motion.reshape(-1, COLUMNS)
        motion = np.linalg.solve(information + expected, weighted @ tiles.pull.reshape(-1)).astype(np.float64)
        residual = tiles.pull - by_motion @ motion
        chi = np.sqrt(np.maximum(_squares(tiles.normal, residual), 0.0))
        # Half of all χ² of two degrees of freedom are less than 2 ln 2.
        scale = max(float(np.median(chi)) / sqrt(2 * log(2)), 1.0) if len(chi) else 1.0
        weight = huber_weights(chi, tiles.huber * scale)
    across, down = (tiles.centre_px // _GROUP_PX).astype(np.int64).T
    group = down * (1 + np.max(across, initial=0)) + across
    scores = (weight[:, None, None] * design * residual[:, :, None]).sum(axis=1)
    inverse = np.linalg.inv(information + expected)
    covariance = inverse @ (clustered_scatter(scores, group) + scale**2 * information + expected) @ inverse
    covariance += _SYSTEMATIC_PX**2 * np.eye(COLUMNS)
    gained = float(np.sum(weight * (_squares(tiles.normal, tiles.pull) - chi**2))) / scale**2
    return RigidFit(motion, covariance, gained)


def _squares(normal: Floats, pull: Floats) -> Floats:
    """Return bᵀ N⁻¹ b of T tiles."""
    squares: Floats = np.einsum("ta,ta->t", pull, solved(normal, pull[..., None])[..., 0])
    return squares
