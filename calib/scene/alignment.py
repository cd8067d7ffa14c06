"""Observations of a scene whose calibration is nearly known: pictures aligned around corners, surfaces that coincide.

The surface around a pixel of one station tells where it is in another's picture, and how the picture around it is
warped there: to second order, for surfaces that all bulge would shift all points alike otherwise. What is left, a
shift, is found by least squares on grey levels (Lucas and Kanade, "An iterative image registration technique", 1981;
Baker and Matthews, "Lucas-Kanade 20 years on", 2004). A surface without a pattern still tells, at each of its pixels,
that what the projector lights there is on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose, depths_of_rays
from calib.geometry import radial_distortion as lens
from calib.numerics import Bools, Floats, Floats32, Ints, at_random
from calib.refinement import State
from calib.scene.rigid_scene import ANYWHERE_PX, CHOSEN_PX, NOTHING_OBSERVED, RigidScene, SceneObservations
from calib.scene.views import WINDOW_PIXELS, Lifted, MatchedView, lift, monomials, quadratic_maps

_CORNERS, _QUALITY, _APART_PX = 200, 0.003, 6.0  # of a picture: how many, least share of the best, distance
_HALF = 7  # pixels around a corner that are compared
_BLUR_PX = 0.8
_STEPS, _CONVERGED_PX = 12, 0.01
_MOST_SHIFT_PX, _MOST_SIGMA_PX, _LEAST_SIGMA_PX = 4.0, 0.3, 0.01
_LEAST_CORRELATION = 0.8
_OVERLAP = 2.0  # windows on a surface that use one pixel: less wastes what it tells
_LEAST_GAIN = 0.1
_MOST_STRETCH = 2.5
_STENCIL = _HALF / 2 * np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
_TERMS = 6  # of an alignment: shift, gain, level and its slopes
# Between where the projector should light a point and where it does: what hides it is further off than most points are.
_OCCLUDED_PX, _OCCLUDED, _MOST_OFF_PX = 2.0, 5.0, 30.0
# Of a surface about a quadratic map, in units of its flattest quarter: around a point, and over all that is compared.
_MOST_BEND, _MOST_WIDE_BEND = 1.5, 2.0


@dataclass(frozen=True, eq=False)
class _Patches:
    """Surface around pixels of a station."""

    camera_px: Floats
    """(K, 2)."""
    lifted: Lifted
    """What the matches around tell."""
    points: Floats
    """(K, 3), in the station's camera frame."""
    tangents: Floats
    """(K, 3, 2): derivatives of `points` by `camera_px`."""
    around: Floats
    """(K, 9, 3): the surface at the `_STENCIL` around `camera_px`; (K, 0, 3) where no pictures are compared."""


@dataclass(frozen=True, eq=False)
class _Projected:
    """Patches of one station in another's picture."""

    number: Ints
    """(M,): of the patches that are seen there."""
    camera_px: Floats
    """(M, 2)."""
    warp: Floats
    """(M, 2, 2): derivatives of `camera_px` by the pixel of the patch's own station."""
    around: Floats
    """(M, 9, 2): where the surface at the `_STENCIL` is seen; (M, 0, 2) where no pictures are compared."""

    def __len__(self) -> int:
        return len(self.number)


def align(scene: RigidScene, views: Sequence[MatchedView]) -> tuple[SceneObservations, Floats]:
    """Observations of points that stations share, under a scene that is nearly right, and the points (N, 3) in the
    first station's frame. `views`: those of the scene's stations.
    """
    pictures = [_blurred(view.brightness) for view in views]
    is_free = [_inside(view) for view in views]
    pieces, points = [NOTHING_OBSERVED], [np.zeros((0, 3))]

    def add(number: int, patches: _Patches, observed: SceneObservations) -> None:
        chosen, point = np.unique(observed.point, return_inverse=True)
        pieces.append(replace(observed, point=point + sum(map(len, points))))
        points.append(scene.stations[number].inverse() @ patches.points[chosen])

    for number, view in enumerate(views):
        corners = _with_surface(scene.rig, view, _patches(scene.rig, view, _corners(view.brightness, is_free[number])))
        tracks = _tracked(scene, views, number, corners, pictures)
        add(number, corners, tracks)
        for station, pixels in zip(
            tracks.station.tolist(), np.rint(tracks.camera_px).astype(int).tolist(), strict=True
        ):
            free = is_free[station].view(np.uint8)
            cv2.circle(free, pixels, int(_APART_PX), 0, -1)
        surface = _flat_patches(scene.rig, view, _inside(view), len(views))
        add(number, surface, _tracked(scene, views, number, surface, None))
    return SceneObservations.joined(pieces), np.concatenate(points)


def _tracked(
    scene: RigidScene,
    views: Sequence[MatchedView],
    number: int,
    patches: _Patches,
    pictures: Sequence[Floats32] | None,
) -> SceneObservations:
    """Patches of a station in the others: aligned in their pictures or, without these, where the surface is.

    Ordered by `point`, the patch's number. Those that no other station sees are left out.
    """
    pieces = [NOTHING_OBSERVED]
    for station, view in enumerate(views):
        if station == number:
            continue
        motion = scene.stations[station] @ scene.stations[number].inverse()
        projected = _projected(scene.rig, motion, patches, view)
        if not len(projected):
            continue
        pixels, sigma = projected.camera_px, np.full(len(projected), ANYWHERE_PX)
        if pictures is not None:
            own_px = patches.camera_px[projected.number]
            shift, sigma = _shifts(pictures[number], pictures[station], own_px, projected)
            pixels = pixels + shift
        lifted = lift(view.places, pixels)
        if pictures is None:
            kept = _is_flat(lifted)
        else:
            _, rms, noise = quadratic_maps(view.places, pixels, _HALF)
            kept = lifted.is_smooth & np.isfinite(sigma) & _is_one_surface(rms, noise)
        pieces.append(_observations(projected.number, station, pixels, lifted, sigma)[kept])
    tracked = SceneObservations.joined(pieces)
    chosen, point = np.unique(tracked.point, return_inverse=True)
    own_sigma = np.full(len(chosen), CHOSEN_PX)
    if pictures is not None:  # half of an alignment's variance is this picture's
        tracked = replace(tracked, keypoint_px=tracked.keypoint_px / np.sqrt(2))
        own_sigma[:] = np.inf
        np.minimum.at(own_sigma, point, tracked.keypoint_px)
    own = _observations(chosen, number, patches.camera_px[chosen], patches.lifted[chosen], own_sigma)
    return SceneObservations.joined([own, tracked])


def _observations(point: Ints, station: int, pixels: Floats, lifted: Lifted, sigma: Floats) -> SceneObservations:
    stations = np.full(len(point), station)
    return SceneObservations(point, stations, pixels, lifted.projector_px, lifted.slope, lifted.sigma_px, sigma)


def _inside(view: MatchedView) -> Bools:
    """Pixels around which all others have matches, (H, W)."""
    known = np.isfinite(view.places[..., 0]).astype(np.uint8)
    inside = cv2.erode(known, np.ones((2 * _HALF + 1,) * 2, np.uint8), borderValue=0)
    return np.asarray(inside > 0)


def _blurred(brightness: NDArray[np.uint8]) -> Floats32:
    return np.asarray(cv2.GaussianBlur(brightness.astype(np.float32), (0, 0), _BLUR_PX), np.float32)


def _corners(brightness: NDArray[np.uint8], mask: Bools) -> Floats:
    """Pixels (K, 2) around which a shift of the picture is seen (Shi and Tomasi, "Good features to track", 1994)."""
    corners = cv2.goodFeaturesToTrack(
        brightness, _CORNERS, _QUALITY, _APART_PX, mask=mask.astype(np.uint8), blockSize=_HALF
    )
    return np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2).astype(np.float64)


def _flat_patches(rig: State, view: MatchedView, inside: Bools, stations: int) -> _Patches:
    """Some of a view's surface, where it is flat."""
    row, column = np.nonzero(inside)
    some = at_random(len(row), int(_OVERLAP * len(row) / (WINDOW_PIXELS * stations)) + 1)
    patches = _patches(rig, view, np.stack([column[some], row[some]], axis=1).astype(np.float64))
    return _some_of(patches, _is_flat(patches.lifted))


def _is_flat(lifted: Lifted) -> Bools:
    """Where a quadratic map describes the surface as well as in its flattest parts, (K,)."""
    return _is_among_flattest(lifted.bend, lifted.is_smooth, _MOST_BEND)


def _is_one_surface(rms: Floats, sigma: Floats) -> Bools:
    """Where a quadratic map describes all that is compared as well as in its flattest parts, by the rms (K,) of what is
    around and its sigma (K,).

    Where it does not, as over an edge, pictures are warped wrongly, and their shifts are wrong alike.
    """
    bend = rms / np.maximum(sigma, 1e-3)
    return _is_among_flattest(bend, np.isfinite(bend), _MOST_WIDE_BEND)


def _is_among_flattest(bend: Floats, known: Bools, most: float) -> Bools:
    """Which (K,) of those that are known bend by less than so many times the flattest quarter."""
    usual = float(np.quantile(bend[known], 0.25)) if known.any() else 0.0
    return known & (bend < most * usual)


def _patches(rig: State, view: MatchedView, pixels: Floats) -> _Patches:
    lifted = lift(view.places, pixels)
    points, tangents = surface_at(rig, pixels, lifted.projector_px, lifted.slope)
    return _some_of(_Patches(pixels, lifted, points, tangents, np.zeros((len(pixels), 0, 3))), lifted.is_smooth)


def _with_surface(rig: State, view: MatchedView, patches: _Patches) -> _Patches:
    """The patches with the surface around them, as far as pictures are compared."""
    fit, rms, sigma = quadratic_maps(view.places, patches.camera_px, _HALF)
    kept = _is_one_surface(rms, sigma)
    patches, fit = _some_of(patches, kept), fit[kept]
    camera_px = patches.camera_px[:, None] + _STENCIL
    projector_px = monomials(*_STENCIL.T) @ fit
    around = _points(rig, camera_px.reshape(-1, 2), projector_px.reshape(-1, 2))
    return replace(patches, around=around.reshape(*camera_px.shape[:2], 3))


def _some_of(patches: _Patches, kept: Bools) -> _Patches:
    return _Patches(*(getattr(patches, field.name)[kept] for field in fields(_Patches)))


def surface_at(rig: State, camera_px: Floats, projector_px: Floats, slope: Floats) -> tuple[Floats, Floats]:
    """Points (K, 3) of a surface in the camera's frame, and their derivatives (K, 3, 2) by the camera's pixel.

    `slope` (K, 2, 2): derivatives of the projector's pixel by the camera's.
    """
    steps = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    here, right, down = (_points(rig, camera_px + step, projector_px + slope @ step) for step in steps)
    return here, np.stack([right - here, down - here], axis=2)


def _points(rig: State, camera_px: Floats, projector_px: Floats) -> Floats:
    """Points (K, 3) on the camera's rays, nearest to those of the projector."""
    rays, _ = lens.unproject(rig.camera, camera_px)
    lines, _ = lens.unproject(rig.projector, projector_px)
    depth = depths_of_rays(rig.pose.rotate(rays), lines, rig.pose.translation)[:, :1]
    return np.asarray(depth * rays, np.float64)


def is_recognisable(warp: Floats) -> Bools:
    """Whether what is warped so (M, 2, 2) can be recognised, (M,): seen from the front, and hardly stretched."""
    stretch = np.linalg.svd(warp, compute_uv=False)
    is_alike = ((stretch < _MOST_STRETCH) & (stretch > 1 / _MOST_STRETCH)).all(axis=1)
    return np.asarray(is_alike & (np.linalg.det(warp) > 0), np.bool_)


def _projected(rig: State, motion: Pose, patches: _Patches, view: MatchedView) -> _Projected:
    """Patches as another station sees them, without hidden ones; `motion`: X_other = R X + t."""
    places = motion @ patches.points
    ahead = places[:, 2] > 0
    safe = np.where(ahead[:, None], places, [0.0, 0.0, 1.0])
    pixels, by_place, _ = lens.project(rig.camera, safe)
    lit_px, _, _ = lens.project(rig.projector, rig.pose @ safe)
    warp = np.where(ahead[:, None, None], by_place @ motion.rotation @ patches.tangents, 0.0)
    height, width = view.brightness.shape
    inside = ((pixels > _HALF) & (pixels < np.array([width, height]) - 1 - _HALF)).all(axis=1)
    number = np.flatnonzero(ahead & inside & is_recognisable(warp))
    if len(number):
        lifted = lift(view.places, pixels[number])
        off = np.abs(lifted.projector_px - lit_px[number]).max(axis=1)
        usual = float(np.median(off[lifted.is_smooth])) if lifted.is_smooth.any() else 0.0
        number = number[lifted.is_smooth & (off < min(_OCCLUDED_PX + _OCCLUDED * usual, _MOST_OFF_PX))]
    around = motion @ patches.around[number].reshape(-1, 3)
    around_px, _, _ = lens.project(rig.camera, around)
    return _Projected(number, pixels[number], warp[number], around_px.reshape(*patches.around[number].shape[:2], 2))


def _shifts(own: Floats32, target: Floats32, own_px: Floats, projected: _Projected) -> tuple[Floats, Floats]:
    """Shifts (M, 2) of patches around `own_px` (M, 2) in another picture, and their standard deviations (M,), which are
    infinite where the pictures do not fit.

    The other's level is the patch's, times a gain, and a level with slopes, for each is lit in its own way.
    """
    steps = np.arange(-_HALF, _HALF + 1, dtype=np.float64)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    window = np.exp(-np.sum(offsets**2, axis=1) / (2 * (_HALF / 2) ** 2))
    root = np.sqrt(window)
    at = own_px[:, None] + offsets
    patch = _sampled(own, at)
    across, down = (_sampled(_slope_of(own, *order), at) for order in ((1, 0), (0, 1)))
    gradient = np.stack([across, down], axis=-1) @ np.linalg.inv(projected.warp)
    slopes = np.broadcast_to(np.column_stack([np.ones(len(offsets)), offsets]), (*patch.shape, 3))
    design = np.concatenate([gradient, patch[..., None], slopes], axis=-1) * root[:, None]
    inverse = np.linalg.pinv(design)  # (M, 6, P)
    there = monomials(*offsets.T) @ (np.linalg.pinv(monomials(*_STENCIL.T)) @ projected.around)
    shift = np.zeros_like(own_px)
    for _ in range(_STEPS):
        level = _sampled(target, there + shift[:, None])
        terms = (inverse @ (root * level)[..., None])[..., 0]
        has_gain = terms[:, 2] > _LEAST_GAIN
        step = np.where(has_gain[:, None], -terms[:, :2] / np.maximum(terms[:, 2:3], _LEAST_GAIN), 0.0)
        shift = np.clip(shift + step, -2 * _MOST_SHIFT_PX, 2 * _MOST_SHIFT_PX)
        if np.abs(step).max(initial=0.0) < _CONVERGED_PX:
            break
    residual = root * level - (design @ terms[..., None])[..., 0]
    variation = np.sum(window * (level - (level @ window)[:, None] / window.sum()) ** 2, axis=1)
    unexplained = np.sum(residual**2, axis=1)
    variance = unexplained / (window.sum() - _TERMS) / np.maximum(terms[:, 2], _LEAST_GAIN) ** 2
    covariance = (inverse @ np.swapaxes(inverse, 1, 2))[:, :2, :2] * variance[:, None, None]
    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, 1], _LEAST_SIGMA_PX**2))
    good = has_gain & (unexplained < (1 - _LEAST_CORRELATION**2) * variation) & (sigma < _MOST_SIGMA_PX)
    good &= (np.abs(step).max(axis=1) < 5 * _CONVERGED_PX) & (np.abs(shift).max(axis=1) < _MOST_SHIFT_PX)
    return shift, np.where(good, sigma, np.inf)


def _slope_of(picture: Floats32, x: int, y: int) -> Floats32:
    """The derivative of levels by x or y."""
    return np.asarray(cv2.Sobel(picture, cv2.CV_32F, x, y, scale=1 / 8), np.float32)


def _sampled(picture: Floats32, at: Floats) -> Floats:
    """Levels (M, P) at pixels (M, P, 2), by cubic interpolation."""
    column, row = (np.ascontiguousarray(at[..., k], np.float32) for k in (0, 1))
    return np.asarray(cv2.remap(picture, column, row, cv2.INTER_CUBIC), np.float64)
