"""Did camera or projector move between the patterns along one axis and those along the other?

Where all of one axis is shown before all of the other, fringes tell nothing of what moves in between. The scene does:
evenly lit in both halves, all of it moves in the camera's picture with the camera, and the border of the projector's
picture alone with the projector.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.halves.borders import Places, lit_in, near_border, places_of_tiles
from scanner.decoding.halves.evenly_lit import EvenlyLit
from scanner.decoding.halves.registration import TileShifts, shifts_of_tiles
from scanner.decoding.halves.tile_moments import centres_of_tiles
from scanner.decoding.motion.found import SUSPECTED_PX, Disturbance, MotionFound
from scanner.decoding.motion.rigid import COLUMNS, PER_DEVICE, Fit, shifts_by_motion
from scanner.decoding.sequence_plan import SequencePlan

# From so many standard deviations on, and so many px, it is more than ripple and noise make at rest.
_SIGNIFICANT = 5.0
_LEAST_PX = 0.02
# What ripple of fringes and fixed patterns do to what is measured, in captures of real devices at rest.
_SYSTEMATIC_PX = 0.01
# Of what nothing is seen: a knock turns a device; it hardly rolls it, and changes no zoom.
_EXPECTED_PX = SUSPECTED_PX * np.tile([1.0, 1.0, 0.3, 0.3], 2)
_NONE_PX = 1e-6
# Among the parts of a motion, pan and tilt of either device.
_TURNS = [0, 1, PER_DEVICE, PER_DEVICE + 1]
# A motion that is not small against the blur of edges is found from coarse to fine.
_COARSE_TO_FINE_PX = (6.0, 3.0, 1.5, 0.0, 0.0)
_SMALL_PX = 0.2
_ROUNDS = 8
_HUBER = 2.0
# The median of the root of what two shifts leave, in standard deviations.
_MEDIAN_CHI = 1.18
# Tiles that are neighbours may have in common what is no motion.
_GROUP_PX = 64
_SINGULAR = 1e-9
# Where a camera pixel covers less of the projector's picture, in its pixels, its coordinates stand still.
_LEAST_AREA = 1e-3


@dataclass(frozen=True)
class _Edges:
    """Pixels (H, W) in the light that show the scene, and those that show the border of the picture; and by how much
    either moves in each of T tiles, (T, 2, 8), per px of each part of the motion, NaN where unknown.
    """

    scene: Bools
    border: Bools
    of_scene: Floats
    of_border: Floats


def motion_between(
    lit: EvenlyLit,
    plan: SequencePlan,
    projector_px: Floats32,
    projector_size: tuple[int, int],
    within: MotionFound | None,
) -> MotionFound:
    """The motion of the devices between the two halves of a capture; sizes are (width, height).

    `projector_px` (H, W, 2): the coordinates of all camera pixels, NaN where unknown. A motion `within` a half that is
    larger takes precedence, and what may have been beside it is added to it.
    """
    height, width, _ = projector_px.shape
    sizes = (width, height), projector_size
    # Codes alone leave steps.
    step_px = 0.0 if plan.fringes else max(axis.cell for axis in plan.axes)
    places = places_of_tiles(projector_px, step_px)
    fit = _of_one_or_both(lit.pictures, _edges(projector_px, step_px, places, *sizes))
    first, second = lit.halves
    shares = np.array([axis.axis == second.axis.axis for axis in plan.axes], np.float64)
    shift = Disturbance(np.outer(shares, fit.motion), *sizes)
    size_px = _typical_px(shift, places, sizes[0])
    significant = fit.significance > _SIGNIFICANT and size_px > _LEAST_PX
    spread = [Disturbance(np.outer(shares, part), *sizes) for part in _independent(fit.covariance)]
    between = MotionFound(
        motion=fit.motion,
        significant=significant,
        slow=False,
        first=plan.repeats * first.last,
        last=plan.repeats * second.first,
        size_px=size_px,
        explained=1.0,
        shift=shift,
        others=(),
        unseen=tuple(spread if significant else [*spread, shift]),
        blind=bool(np.sqrt(np.diag(fit.covariance))[_TURNS].max() > SUSPECTED_PX / 2),
    )
    if within is None or not within.significant or (significant and size_px > within.size_px):
        return between
    return replace(within, unseen=between.unseen, blind=between.blind)


def _edges(
    projector_px: Floats32, step_px: float, places: Places, camera_size: tuple[int, int], size: tuple[int, int]
) -> _Edges:
    centre = centres_of_tiles(projector_px.shape[:2]).reshape(-1, 2)
    # With this gradient, what a device's picture does; the sign is that of coordinates in the projector's.
    flat = np.broadcast_to(-np.eye(2), (len(centre), 2, 2))
    moved = shifts_by_motion(centre, places.projector_px, flat, camera_size, size)
    scene, border = moved.copy(), moved.copy()
    scene[:, :, :PER_DEVICE] = 0.0
    gradient = np.nan_to_num(places.gradient)
    known = np.abs(np.linalg.det(gradient)) > _LEAST_AREA
    gradient[~known] = np.eye(2)
    border[:, :, :PER_DEVICE] = -np.linalg.solve(gradient, moved[:, :, :PER_DEVICE])
    border[~known] = np.nan
    # In the dark a camera's fixed pattern, which rests, is much of what is seen.
    is_border = near_border(projector_px, size, step_px)
    return _Edges(lit_in(projector_px) & ~is_border, is_border, scene, border)


def _of_one_or_both(pictures: tuple[Floats32, Floats32], edges: _Edges) -> Fit:
    """The motion from the earlier picture to the later one; of one device where the other has hardly moved."""
    fit = _measured(pictures, edges, _EXPECTED_PX)
    devices = np.split(np.arange(COLUMNS), [PER_DEVICE])
    sure = [replace(fit, motion=fit.motion[one], covariance=fit.covariance[np.ix_(one, one)]) for one in devices]
    less, more = sorted((0, 1), key=lambda device: sure[device].significance)
    if not sure[less].significance < _SIGNIFICANT < sure[more].significance:
        return fit
    expected_px = _EXPECTED_PX.copy()
    expected_px[devices[less]] = _NONE_PX
    return replace(fit, motion=_measured(pictures, edges, expected_px).motion)


def _measured(pictures: tuple[Floats32, Floats32], edges: _Edges, expected_px: Floats) -> Fit:
    fit = _fit(pictures, edges, expected_px, 0.0)
    if np.abs(fit.motion).max() < _SMALL_PX:
        return fit
    before, after = pictures
    camera = np.zeros(PER_DEVICE)
    for blur_px in _COARSE_TO_FINE_PX:
        fit = _fit((before, _moved_back(after, camera)), edges, expected_px, blur_px)
        camera += fit.motion[PER_DEVICE:]
    return replace(fit, motion=np.concatenate([fit.motion[:PER_DEVICE], camera]))


def _moved_back(picture: Floats32, motion: Floats) -> Floats32:
    """A picture (H, W) as it was before the camera's motion (4,)."""
    height, width = picture.shape
    right, down, roll, zoom = motion
    middle = (np.array([width, height]) - 1) / 2
    turn = np.eye(2) + np.array([[zoom, -roll], [roll, zoom]]) / (width / 2)
    offset = middle + np.array([right, down]) - turn @ middle
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    back = cv2.warpAffine(
        picture, np.column_stack([turn, offset]), (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(back, np.float32)


def _fit(pictures: tuple[Floats32, Floats32], edges: _Edges, expected_px: Floats, blur_px: float) -> Fit:
    scene = shifts_of_tiles(*pictures, edges.scene, blur_px)
    border = shifts_of_tiles(*pictures, edges.border, blur_px)
    known = np.isfinite(edges.of_border).all(axis=(1, 2))
    centre_px, normal, pull = (
        np.concatenate([getattr(scene, name), getattr(border, name)[known]]) for name in ("centre_px", "normal", "pull")
    )
    design = np.concatenate([edges.of_scene, edges.of_border[known]])
    tells = normal.trace(axis1=1, axis2=2) > 0
    return _least_squares(design[tells], expected_px, TileShifts(centre_px[tells], normal[tells], pull[tells]))


def _least_squares(design: Floats, expected_px: Floats, tiles: TileShifts) -> Fit:
    """Robust least squares of the motion (8,), with what is expected where nothing is seen."""
    expected = np.diag(1 / expected_px**2)
    by_motion = tiles.normal @ design
    weight = np.ones(len(design))
    for _ in range(_ROUNDS):
        information = np.einsum("t,tac,tad->cd", weight, design, by_motion)
        motion = np.linalg.solve(information + expected, np.einsum("t,tac,ta->c", weight, design, tiles.pull))
        left = tiles.pull - by_motion @ motion
        chi = np.sqrt(np.maximum(_squares(tiles.normal, left), 0.0))
        scale = max(float(np.median(chi)) / _MEDIAN_CHI, 1.0) if len(chi) else 1.0
        weight = np.minimum(1.0, _HUBER * scale / np.maximum(chi, 1e-9))
    _, group = np.unique(tiles.centre_px // _GROUP_PX, axis=0, return_inverse=True)
    scores = np.einsum("t,tac,ta->tc", weight, design, left)
    sums = np.stack([np.bincount(group.reshape(-1), column) for column in scores.T], axis=1)
    inverse = np.linalg.inv(information + expected)
    covariance = inverse @ (sums.T @ sums + scale**2 * information + expected) @ inverse
    covariance += _SYSTEMATIC_PX**2 * np.eye(COLUMNS)
    gained = float(np.sum(weight * (_squares(tiles.normal, tiles.pull) - chi**2))) / scale**2
    return Fit(motion, covariance, gained)


def _squares(normal: Floats, pull: Floats) -> Floats:
    """bᵀ N⁻¹ b of T tiles."""
    size = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    shift = np.linalg.solve(normal + _SINGULAR * size * np.eye(2), pull[..., None])[..., 0]
    squares: Floats = np.einsum("ta,ta->t", pull, shift)
    return squares


def _independent(covariance: Floats) -> Floats:
    """Vectors (8, 8), one per row, that together have this covariance."""
    values, vectors = np.linalg.eigh(covariance)
    rows: Floats = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    return rows


def _typical_px(shift: Disturbance, places: Places, camera_size: tuple[int, int]) -> float:
    """How far coordinates were shifted: root mean square over the tiles where they are known."""
    centre = centres_of_tiles(camera_size[::-1]).reshape(-1, 2)
    known = np.isfinite(places.gradient).all(axis=(1, 2))
    shifts = shift.shifts(centre[known], places.projector_px[known], places.gradient[known])
    return float(np.sqrt(np.mean(np.sum(shifts**2, axis=1)))) if len(shifts) else 0.0
