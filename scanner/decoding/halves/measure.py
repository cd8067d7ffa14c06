"""Did camera or projector move between the patterns along one axis and those along the other?

Where all of one axis is shown before all of the other, fringes tell nothing of what moves in between. The scene does:
evenly lit in both halves, all of it moves in the camera's picture with the camera, and the border of the projector's
picture alone with the projector.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.numerics import Floats
from scanner.decoding.arrays import Floats32
from scanner.decoding.halves.borders import Places, places_of_tiles
from scanner.decoding.halves.edges import Edges, Shown
from scanner.decoding.halves.evenly_lit import EvenlyLit, pairs_of
from scanner.decoding.halves.moment import Moment, moment_of
from scanner.decoding.halves.registration import TileShifts, shifts_of_tiles
from scanner.decoding.halves.tile_moments import centres_of_tiles
from scanner.decoding.motion.found import SUSPECTED_PX, Disturbance, MotionFound, turns_px
from scanner.decoding.motion.rigid import COLUMNS, PER_DEVICE, Fit
from scanner.decoding.sequence_plan import SequencePlan

# From so many standard deviations on, and so many px, it is more than ripple and noise make at rest.
_SIGNIFICANT = 5.0
_LEAST_PX = 0.02
# What all of the scene, or of a border, shows is known to be one motion.
_LARGEST_PX = 0.5
# A camera that moved farther sees other things beside the edges of things, and moved along with its tripod's head.
_LARGEST_OF_CAMERA_PX = 0.75
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
# Such a fit is believed if its last step is this small, and it explains this share of what the pictures differ by where
# they have edges: without texture it finds what is not there.
_CONVERGED_PX, _EXPLAINED = 0.1, 0.5
# The border is looked for within so many camera px of where it should be: what is beside it rests. Where it may be
# elsewhere, within more, and so many times the blur.
_REACH_PX, _COARSE_REACH_PX, _REACH_OF_BLUR = 4.0, 10.0, 2.0
# One pair that differs from all others does so by its stripes.
_FEWEST_PAIRS = 2
# Two pairs do so by as much, where fine stripes are sharpened.
_LEAST_WITHIN_PX = 0.1
# Where edges are of before and of after, coordinates between them scatter; so much of that is in their means.
_MIXED = 0.2
# A motion within a half explains so much more than one between them.
_LIKELIER = 1.3
_ROUNDS = 8
_HUBER = 2.0
# The median of the root of what two shifts leave, in standard deviations.
_MEDIAN_CHI = 1.18
# Tiles that are neighbours may have in common what is no motion.
_GROUP_PX = 64
_SINGULAR = 1e-9


@dataclass(frozen=True)
class _Course:
    """A motion between two frames, of which x and y are shifted against each other by a `share`, with its `sigma`."""

    share: float = 1.0
    sigma: float = 0.0
    first: int | None = None
    last: int | None = None

    @property
    def others(self) -> tuple[float, ...]:
        """Shares that may as well be the true one."""
        return (self.share - self.sigma, self.share + self.sigma) if self.sigma else ()


_BETWEEN = _Course()


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
    first, second = lit.halves
    shares = np.array([axis.axis == second.axis.axis for axis in plan.axes], np.float64)
    edges = Edges(projector_px, step_px, places, shares, projector_size)
    fit, course = _of_one_or_both(lit.pictures, edges), _BETWEEN
    for other in _within_halves(lit, edges):
        of_other = _of_one_or_both(lit.pictures_of(other.before, other.after), edges)
        # Between the halves it looks smaller than it was.
        larger = np.hypot(*turns_px(of_other.motion)) > max(np.hypot(*turns_px(fit.motion)), _LEAST_WITHIN_PX)
        if larger and of_other.significance > _SIGNIFICANT:
            fit, course = of_other, _course(lit, plan, other)
    _, camera_px = turns_px(fit.motion)
    shift = Disturbance(np.outer(shares, course.share * fit.motion), *sizes)
    size_px = _typical_px(shift, places, sizes[0])
    significant = fit.significance > _SIGNIFICANT and size_px > _LEAST_PX
    spread = [Disturbance(np.outer(shares, part), *sizes) for part in _independent(course.share**2 * fit.covariance)]
    between = MotionFound(
        motion=fit.motion,
        significant=significant,
        slow=False,
        first=plan.repeats * (first.last if course.first is None else course.first),
        last=plan.repeats * (second.first if course.last is None else course.last),
        size_px=size_px,
        explained=1.0,
        shift=shift,
        others=tuple(Disturbance(np.outer(shares, one * fit.motion), *sizes) for one in course.others),
        unseen=tuple(spread if significant else [*spread, shift]),
        blind=bool(np.sqrt(np.diag(fit.covariance))[_TURNS].max() > SUSPECTED_PX / 2),
        largest_px=_LARGEST_PX if camera_px < _LARGEST_OF_CAMERA_PX else 0.0,
    )
    if within is None or not within.significant or (significant and size_px > within.size_px):
        return between
    return replace(within, unseen=between.unseen, blind=between.blind)


def _within_halves(lit: EvenlyLit, edges: Edges) -> Iterator[Moment]:
    """When pairs of codes changed, if that was not between the halves: by the scene, and by the border."""
    if not lit.of_pairs:
        return
    seen = set()  # both mostly tell the same
    first = len(pairs_of(lit.halves[0].axis))
    shown = edges.beside(np.zeros(COLUMNS), _COARSE_REACH_PX)
    for chosen in (shown.scene, shown.border):
        moment = moment_of([*lit.of_pairs.values()], chosen, first)
        if moment is None or min(len(moment.before), len(moment.after)) < _FEWEST_PAIRS:
            continue
        groups = moment.before, moment.after
        if moment.gained > _LIKELIER and groups not in seen:
            seen.add(groups)
            yield moment


def _course(lit: EvenlyLit, plan: SequencePlan, moment: Moment) -> _Course:
    """What a change at this moment does to the coordinates: half of a code's edges are those of its finest bit."""
    done = dict(zip(lit.of_pairs, moment.done.tolist(), strict=True))
    of_halves = []
    for half in lit.halves:
        pairs = pairs_of(half.axis)
        edges = {bit: 2.0**bit for bit in pairs}
        of_halves.append(sum(edges[bit] * done[pair] for bit, pair in pairs.items()) / sum(edges.values()))
    places = [sorted(plan.shown.index(frame) for frame in pair) for pair in lit.of_pairs]
    before, after = places[max(moment.before)], places[min(moment.after)]
    mixed = max(np.sqrt(share * (1 - share)) for share in of_halves)
    return _Course(of_halves[1] - of_halves[0], _MIXED * mixed, before[-1], after[0])


def _of_one_or_both(pictures: tuple[Floats32, Floats32], edges: Edges) -> Fit:
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


def _measured(pictures: tuple[Floats32, Floats32], edges: Edges, expected_px: Floats) -> Fit:
    """Where it is not small, from coarse to fine: of both devices if that can be believed, or of the camera alone."""
    at_rest = np.zeros(COLUMNS)
    fit = _fit(pictures, edges, edges.decoded, at_rest, expected_px)
    coarsest_px, *finer_px = _COARSE_TO_FINE_PX
    step = _fit_beside(pictures, edges, at_rest, expected_px, coarsest_px)
    largest_px = float(np.abs(fit.motion).max())
    if max(largest_px, float(np.abs(step.motion).max())) < _SMALL_PX:
        return fit
    motion = step.motion
    for blur_px in finer_px:
        step = _fit_beside(pictures, edges, motion, expected_px, blur_px)
        motion = motion + step.motion
    if np.abs(step.motion).max() < _CONVERGED_PX and _explained(pictures, edges, motion) > _EXPLAINED:
        return replace(step, motion=motion)
    if largest_px < _SMALL_PX:
        return fit
    camera = at_rest.copy()
    for blur_px in _COARSE_TO_FINE_PX:
        fit = _fit(pictures, edges, edges.decoded, camera, expected_px, blur_px)
        camera[PER_DEVICE:] += fit.motion[PER_DEVICE:]
    return replace(fit, motion=np.concatenate([fit.motion[:PER_DEVICE], camera[PER_DEVICE:]]))


def _fit_beside(
    pictures: tuple[Floats32, Floats32], edges: Edges, motion: Floats, expected_px: Floats, blur_px: float
) -> Fit:
    """A step from coarse to fine: what there is beside a motion (8,), with the border where the planes put it.

    While the border may be anywhere, all tiles are believed alike: most of it may run along the motion.
    """
    reach_px = _COARSE_REACH_PX + _REACH_OF_BLUR * blur_px if blur_px else _REACH_PX
    shown = edges.beside(motion, reach_px)
    return _fit(pictures, edges, shown, motion, expected_px, blur_px, anywhere=blur_px > 0)


def _explained(pictures: tuple[Floats32, Floats32], edges: Edges, motion: Floats) -> float:
    """The share, in squares, of what the pictures (H, W) differ by at their edges that a motion (8,) explains."""
    before, after = pictures
    of_scene, of_border = edges.taken_back(after, motion)
    shown = edges.beside(motion, _REACH_PX)
    steepness = np.square(cv2.Sobel(before, cv2.CV_32F, 1, 0)) + np.square(cv2.Sobel(before, cv2.CV_32F, 0, 1))
    left = sum(
        float(np.sum((steepness * np.square(back - before))[at]))
        for back, at in ((of_scene, shown.scene), (of_border, shown.border))
    )
    differ = float(np.sum((steepness * np.square(after - before))[shown.scene | shown.border]))
    return 1 - left / max(differ, 1e-12)


def _fit(
    pictures: tuple[Floats32, Floats32],
    edges: Edges,
    shown: Shown,
    motion: Floats,
    expected_px: Floats,
    blur_px: float = 0.0,
    *,
    anywhere: bool = False,
) -> Fit:
    """What there is beside a motion (8,); a border that may be `anywhere` has no light of its own, and no outliers."""
    before, after = pictures
    of_scene, of_border = edges.taken_back(after, motion) if motion.any() else (after, after)
    scene = shifts_of_tiles(before, of_scene, shown.scene, blur_px)
    border = shifts_of_tiles(before, of_border, shown.border, blur_px, own_light=not anywhere)
    known = np.isfinite(shown.of_border).all(axis=(1, 2))
    centre_px, normal, pull = (
        np.concatenate([getattr(scene, name), getattr(border, name)[known]]) for name in ("centre_px", "normal", "pull")
    )
    design = np.concatenate([edges.of_scene, shown.of_border[known]])
    tells = normal.trace(axis1=1, axis2=2) > 0
    tiles = TileShifts(centre_px[tells], normal[tells], pull[tells])
    return _least_squares(design[tells], expected_px, tiles, np.inf if anywhere else _HUBER)


def _least_squares(design: Floats, expected_px: Floats, tiles: TileShifts, huber: float) -> Fit:
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
        weight = np.minimum(1.0, huber * scale / np.maximum(chi, 1e-9))
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
