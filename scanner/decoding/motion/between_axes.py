"""Measurement of camera or projector motion between the patterns along one axis and those along the other.

Fringes do not observe a motion between the axes. The evenly lit scene does. The mean of a fringe over its shifts, and
that of a pattern and its inverse, equal half of white, whatever the pattern. All patterns along x together thus give
one picture of the scene, those along y another. They are compared if all of one axis is shown before all of the other.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import cv2
import numpy as np

from calib.numerics import (
    MANY_PIXELS,
    STRIP_ROWS,
    Floats,
    Floats32,
    Image,
    Ints,
    Window,
    chosen_ones,
    compiled,
    in_slices,
)
from scanner.decoding.coordinates import CodeImages
from scanner.decoding.motion.borders import REACH_PX, Edges, part_around, places_of_tiles
from scanner.decoding.motion.coarse_to_fine import TimeOfChange, motion_of, time_of_change
from scanner.decoding.motion.device_motion import (
    LEAST_PX,
    SUSPECTED_PX,
    CoordinateShift,
    MotionEstimate,
    turns_px,
)
from scanner.decoding.motion.pixels import COLUMNS, PER_DEVICE
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.decoding.significance import AS_GOOD, FEWEST_PIXELS, SIGNIFICANT_SIGMAS


@dataclass(frozen=True)
class Half:
    """The frames that measure an axis."""

    axis: AxisPlan
    """Which."""
    first: int
    """Place of the first of them in the capture."""
    last: int
    """Place of the last."""
    weights: dict[int, float]
    """Of frames in the mean picture, by number; empty if no frames add up to even light."""


def halves_of(plan: SequencePlan) -> tuple[Half, Half] | None:
    """Return the two halves of a capture in order of time; None unless one axis is measured before the other."""
    if not all(axis.is_measured for axis in plan.axes):
        return None
    first, second = sorted((_half(plan, axis) for axis in plan.axes), key=lambda half: half.first)
    return (first, second) if first.last < second.first else None


def _half(plan: SequencePlan, axis: AxisPlan) -> Half:
    frames = {frame for fringe in axis.fringes for frame in fringe.frames}
    # With fringes, codes only select the period.
    frames = frames or {frame for code in axis.codes for frame in code.frames}
    places = [place for place, frame in enumerate(plan.shown) if frame in frames]
    return Half(axis, min(places), max(places), _weights(axis))


def _weights(axis: AxisPlan) -> dict[int, float]:
    weights: dict[int, float] = {}
    groups = [dict(zip(fringe.frames, fringe.weights[0].tolist(), strict=True)) for fringe in axis.fringes] or [
        dict.fromkeys(pair, 0.5) for pair in dict.fromkeys(pair for code in axis.codes for pair in code.pairs.values())
    ]
    for group in groups:
        for frame, weight in group.items():
            weights[frame] = weights.get(frame, 0.0) + weight / len(groups)
    return weights


def pairs_of(axis: AxisPlan) -> dict[int, tuple[int, int]]:
    """Return bit → frames of pattern and inverse, if a Gray code alone gives the coordinate."""
    return axis.codes[0].pairs if len(axis.codes) == 1 and not axis.fringes else {}


@dataclass(frozen=True)
class EvenlyLit:
    """The scene as it looks evenly lit, while each axis was measured."""

    halves: tuple[Half, Half]
    """The halves of the capture."""
    frames: Callable[[], Iterable[tuple[int, Image]]]
    """Reads the frames (H, W), by number."""
    pictures: tuple[Floats32, Floats32]
    """Of the halves, (H, W) each."""
    pairs: tuple[tuple[int, int], ...]
    """Frames of pattern and inverse, for codes alone, in order of display. If the two differ in brightness, stripes
    remain in their mean, which move with neither device."""
    levels: tuple[Image, ...]
    """For each group of pixels asked for, the means of the pairs there, (pairs, P)."""

    def pictures_of(self, before: Sequence[int], after: Sequence[int]) -> tuple[Floats32, Floats32]:
        """Return the mean pictures (H, W) of two groups of pairs, given by number."""
        shape = self.pictures[0].shape
        totals = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        group_of = {self.pairs[k]: total for group, total in zip((before, after), totals, strict=True) for k in group}
        unpaired: dict[tuple[int, int], Image] = {}
        pair_of = {frame: pair for pair in group_of for frame in pair}
        for number, grey in self.frames():
            if (pair := pair_of.get(number)) is None:
                continue
            if pair in unpaired:
                cv2.accumulate(_mean(unpaired.pop(pair), grey), group_of[pair])
            else:
                unpaired[pair] = grey
        for group, total in zip((before, after), totals, strict=True):
            total /= len(group)
        return totals


def evenly_lit(halves: tuple[Half, Half], code_images: CodeImages, part: Window, groups: Sequence[Ints]) -> EvenlyLit:
    """Add up the frames of a capture that belong to a half, in a part of the image (H, W); at `groups` of its pixels,
    of ascending flat indices (P,), mean each pair of them.
    """
    rows, columns = part
    height, width = rows.stop - rows.start, columns.stop - columns.start
    pictures = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    order = code_images.plan.shown.index
    pairs = sorted((pair for half in halves for pair in pairs_of(half.axis).values()), key=lambda p: max(map(order, p)))
    pairs.sort(key=lambda pair: min(map(order, pair)))
    levels = tuple(np.empty((len(pairs), len(pixels)), code_images.white.dtype) for pixels in groups)
    needed = {frame for half in halves for frame in half.weights} | {frame for pair in pairs for frame in pair}

    def add(strip: slice) -> None:
        there = slice(rows.start + strip.start, rows.start + strip.stop), columns
        frames, places, corner = code_images.stacked(there, sorted(needed, key=order))
        for half, picture in zip(halves, pictures, strict=True):
            ordered = sorted(half.weights, key=order)
            weights = np.array([half.weights[frame] for frame in ordered], np.float32)
            _add_up(frames, np.array([places[frame] for frame in ordered], np.int64), weights, corner, picture[strip])
        of_pairs = np.array([[places[frame] for frame in pair] for pair in pairs], np.int64).reshape(-1, 2)
        for pixels, means in zip(groups, levels, strict=True):
            own = slice(*np.searchsorted(pixels, (strip.start * width, strip.stop * width)).tolist())
            _note_means(frames, of_pairs, corner, pixels[own] - strip.start * width, width, means[:, own])

    in_slices(height, STRIP_ROWS, add)
    return EvenlyLit(halves, partial(code_images.equalised, part), pictures, tuple(pairs), levels)


@compiled
def _add_up(frames: Image, places: Ints, weights: Floats32, corner: tuple[int, int], picture: Floats32) -> None:
    """Add the weighted frames at some places of (N, ...), from a corner on, to a picture (H, W)."""
    top, left = corner
    height, width = picture.shape
    for row in range(height):
        total = picture[row]
        for k in range(len(places)):
            levels, weight = frames[places[k], top + row, left : left + width], weights[k]
            for i in range(width):
                total[i] += weight * np.float32(levels[i])


@compiled
def _note_means(frames: Image, pairs: Ints, corner: tuple[int, int], pixels: Ints, width: int, means: Image) -> None:
    """Note the means (pairs, P), in whole grey levels, of pairs of frames (N, ...) at pixels of a strip that begins at
    a corner of them.
    """
    top, left = corner
    for pair in range(len(pairs)):
        pattern, inverse = frames[pairs[pair, 0]], frames[pairs[pair, 1]]
        for k in range(len(pixels)):
            row, column = top + pixels[k] // width, left + pixels[k] % width
            total = np.int64(pattern[row, column]) + np.int64(inverse[row, column])
            half = total >> 1
            means[pair, k] = half + (total & half & 1)  # a half is rounded to the even number, as by OpenCV


def _mean(pattern: Image, inverse: Image) -> Image:
    return cast(Image, cv2.addWeighted(pattern, 0.5, inverse, 0.5, 0).reshape(pattern.shape))


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
    code_images: CodeImages,
    projector_px: Floats32,
    projector_size: tuple[int, int],
    within: MotionEstimate | None,
) -> MotionEstimate:
    """Return the motion of the devices between the two `halves` of a capture; sizes are (width, height).

    `projector_px` (H, W, 2): coordinates of all camera pixels, NaN where unknown. A larger motion `within` a half takes
    precedence; the uncertainty of the motion between the halves is then added to it.
    """
    height, width, _ = projector_px.shape
    sizes, plan = ((width, height), projector_size), code_images.plan
    # Codes alone give coordinates in steps.
    step_px = 0.0 if plan.fringes else max(axis.cell for axis in plan.axes)
    rows, columns = part = part_around(projector_px)
    projector_px = np.ascontiguousarray(projector_px[part])
    places = places_of_tiles(projector_px, step_px)
    first, second = halves
    shares = np.array([axis.axis == second.axis.axis for axis in plan.axes], np.float64)
    edges = Edges(
        projector_px, step_px, places, shares, projector_size, camera_size=sizes[0], origin=(columns.start, rows.start)
    )
    lit = evenly_lit(halves, code_images, part, _compared_pixels(halves, edges))
    fit, timing = motion_of(lit.pictures, edges), _BETWEEN
    for moment in _within_halves(lit):
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


def _compared_pixels(halves: tuple[Half, Half], edges: Edges) -> list[Ints]:
    """Return the pixels, flat indices (P,), at which the pictures of code pairs are compared: of the scene, then of the
    border; none if the halves have no pairs, or where there are too few.
    """
    if not any(pairs_of(half.axis) for half in halves):
        return []
    pixels = edges.beside(np.zeros(COLUMNS), REACH_PX)
    groups = []
    for chosen in (pixels.scene, pixels.border):
        count = np.count_nonzero(chosen)
        if count >= FEWEST_PIXELS:
            groups.append(chosen_ones(chosen, np.arange(0, count, -(-count // MANY_PIXELS))))
    return groups


def _within_halves(lit: EvenlyLit) -> Iterator[TimeOfChange]:
    """Yield the times, other than between the halves, at which pictures of code pairs changed: the scene, then the
    border.
    """
    found_groups = set()  # scene and border mostly agree
    first = len(pairs_of(lit.halves[0].axis))
    # Relative widths: the stripes of a bit are half as wide as those of the coarser one before it.
    bits = {pair: (half.axis, bit) for half in lit.halves for bit, pair in pairs_of(half.axis).items()}
    stripes = [axis.cell * 2.0 ** (max(pairs_of(axis)) - bit) for axis, bit in (bits[pair] for pair in lit.pairs)]
    for levels in lit.levels:
        moment = time_of_change(levels, first, stripes)
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
    done = dict(zip(lit.pairs, moment.done.tolist(), strict=True))
    of_halves = []
    for half in lit.halves:
        pairs = pairs_of(half.axis)
        edges = {bit: 2.0**bit for bit in pairs}
        of_halves.append(sum(edges[bit] * done[pair] for bit, pair in pairs.items()) / sum(edges.values()))
    places = [sorted(plan.shown.index(frame) for frame in pair) for pair in lit.pairs]
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
