"""Measurement of camera or projector motion between the patterns along one axis and those along the other.

Fringes do not observe a motion between the axes. The evenly lit scene does: all of it moves in the camera's picture
with the camera, and the border of the projector's picture also with the projector.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import Floats, Floats32
from scanner.decoding.between_axes.borders import REACH_PX, part_around, places_of_tiles
from scanner.decoding.between_axes.coarse_to_fine import motion_of
from scanner.decoding.between_axes.edges import Edges
from scanner.decoding.between_axes.evenly_lit import EvenlyLit, Half, evenly_lit, pairs_of
from scanner.decoding.between_axes.time_of_change import TimeOfChange, time_of_change
from scanner.decoding.code_images import Frames
from scanner.decoding.motion import (
    COLUMNS,
    LEAST_PX,
    PER_DEVICE,
    SUSPECTED_PX,
    CoordinateShift,
    MotionEstimate,
    turns_px,
)
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import AS_GOOD, SIGNIFICANT_SIGMAS

# Largest motion to be corrected: scene and border each show one common motion.
_LARGEST_PX = 0.5
# A camera that moved farther sees occlusions change, and has shifted on its tripod.
_LARGEST_OF_CAMERA_PX = 0.75
# A single pair may differ because of its stripes.
_FEWEST_PAIRS = 2
# Coordinates scatter where code edges are from both before and after the motion; this share of the scatter remains in
# their means.
_MIXED = 0.2


@dataclass(frozen=True)
class _Timing:
    """The time of a motion, between the frames `first` and `last`.

    `share`: the part of it by which x and y are shifted against each other, with its `sigma`.
    """

    share: float = 1.0
    sigma: float = 0.0
    first: int | None = None
    last: int | None = None

    @property
    def alternatives(self) -> tuple[float, ...]:
        """Alternative shares, one standard deviation away."""
        return (self.share - self.sigma, self.share + self.sigma) if self.sigma else ()


_BETWEEN = _Timing()


def motion_between(
    halves: tuple[Half, Half],
    frames: Frames,
    plan: SequencePlan,
    projector_px: Floats32,
    projector_size: tuple[int, int],
    within: MotionEstimate | None,
) -> MotionEstimate:
    """Return the motion of the devices between the two `halves` of a capture; sizes are (width, height).

    `projector_px` (H, W, 2): coordinates of all camera pixels, NaN where unknown. A larger motion `within` a half takes
    precedence; the uncertainty of the motion between the halves is then added to it.
    """
    height, width, _ = projector_px.shape
    sizes = (width, height), projector_size
    # Codes alone give coordinates in steps.
    step_px = 0.0 if plan.fringes else max(axis.cell for axis in plan.axes)
    rows, columns = part = part_around(projector_px)
    projector_px = np.ascontiguousarray(projector_px[part])
    lit = evenly_lit(halves, frames(part), (projector_px.shape[0], projector_px.shape[1]))
    places = places_of_tiles(projector_px, step_px)
    first, second = halves
    shares = np.array([axis.axis == second.axis.axis for axis in plan.axes], np.float64)
    edges = Edges(
        projector_px, step_px, places, shares, projector_size, camera_size=sizes[0], origin=(columns.start, rows.start)
    )
    fit, timing = motion_of(lit.pictures, edges), _BETWEEN
    for moment in _within_halves(lit, edges):
        of_other = motion_of(lit.pictures_of(moment.before, moment.after), edges)
        # The pictures of the halves mix before and after, so that the motion looks smaller there.
        larger = np.hypot(*turns_px(of_other.motion)) > np.hypot(*turns_px(fit.motion))
        if larger and of_other.significance > SIGNIFICANT_SIGMAS:
            fit, timing = of_other, _timing_of(lit, plan, moment)
    _, camera_px = turns_px(fit.motion)
    shift = CoordinateShift(np.outer(shares, timing.share * fit.motion), *sizes)
    size_px = _typical_px(shift, edges)
    significant = fit.significance > SIGNIFICANT_SIGMAS and size_px > LEAST_PX
    spread = [
        CoordinateShift(np.outer(shares, part), *sizes) for part in _independent(timing.share**2 * fit.covariance)
    ]
    turns = np.diag(fit.covariance).reshape(-1, PER_DEVICE)[:, :2]  # pan and tilt of either device
    between = MotionEstimate(
        motion=fit.motion,
        significant=significant,
        slow=False,
        first=plan.repeats * (first.last if timing.first is None else timing.first),
        last=plan.repeats * (second.first if timing.last is None else timing.last),
        size_px=size_px,
        explained=1.0,
        shift=shift,
        alternatives=tuple(
            CoordinateShift(np.outer(shares, alternative * fit.motion), *sizes) for alternative in timing.alternatives
        ),
        unseen=tuple(spread if significant else [*spread, shift]),
        blind=bool(np.sqrt(turns).max() > SUSPECTED_PX / 2),
        largest_px=_LARGEST_PX if camera_px < _LARGEST_OF_CAMERA_PX else 0.0,
    )
    if within is None or not within.significant or (significant and size_px > within.size_px):
        return between
    return replace(within, unseen=between.unseen, blind=between.blind)


def _within_halves(lit: EvenlyLit, edges: Edges) -> Iterator[TimeOfChange]:
    """Yield the times, other than between the halves, at which pictures of code pairs changed: the scene, then the
    border.
    """
    if not lit.of_pairs:
        return
    found_groups = set()  # scene and border mostly agree
    first = len(pairs_of(lit.halves[0].axis))
    # Relative widths: the stripes of a bit are half as wide as those of the coarser one before it.
    bits = {pair: (half.axis, bit) for half in lit.halves for bit, pair in pairs_of(half.axis).items()}
    stripes = [axis.cell * 2.0 ** (max(pairs_of(axis)) - bit) for axis, bit in (bits[pair] for pair in lit.of_pairs)]
    pixels = edges.beside(np.zeros(COLUMNS), REACH_PX)
    for chosen in (pixels.scene, pixels.border):
        moment = time_of_change([*lit.of_pairs.values()], chosen, first, stripes)
        if moment is None or min(len(moment.before), len(moment.after)) < _FEWEST_PAIRS:
            continue
        groups = moment.before, moment.after
        if AS_GOOD * moment.gained > 1 and groups not in found_groups:
            found_groups.add(groups)
            yield moment


def _timing_of(lit: EvenlyLit, plan: SequencePlan, moment: TimeOfChange) -> _Timing:
    """Return the effect of a change at this moment on the coordinates: half of the edges of a code belong to its finest
    bit.
    """
    done = dict(zip(lit.of_pairs, moment.done.tolist(), strict=True))
    of_halves = []
    for half in lit.halves:
        pairs = pairs_of(half.axis)
        edges = {bit: 2.0**bit for bit in pairs}
        of_halves.append(sum(edges[bit] * done[pair] for bit, pair in pairs.items()) / sum(edges.values()))
    places = [sorted(plan.shown.index(frame) for frame in pair) for pair in lit.of_pairs]
    before, after = places[max(moment.before)], places[min(moment.after)]
    mixed = max(np.sqrt(share * (1 - share)) for share in of_halves)
    return _Timing(of_halves[1] - of_halves[0], _MIXED * mixed, before[-1], after[0])


def _independent(covariance: Floats) -> Floats:
    """Factor a covariance into independent vectors (8, 8), one per row."""
    values, vectors = np.linalg.eigh(covariance)
    rows: Floats = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    return rows


def _typical_px(shift: CoordinateShift, edges: Edges) -> float:
    """Return the root mean square shift of the coordinates over the known tiles."""
    places = edges.places
    known = np.isfinite(places.gradient).all(axis=(1, 2))
    shifts = shift.shifts(edges.centre[known], places.projector_px[known], places.gradient[known])
    return float(np.sqrt(np.mean(np.sum(shifts**2, axis=1)))) if len(shifts) else 0.0
