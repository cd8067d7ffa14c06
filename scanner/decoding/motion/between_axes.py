"""Measurement of camera or projector motion between the patterns along one axis and those along the other.

Fringes do not observe a motion between the axes. The evenly lit scene does. The mean of a fringe over its shifts, and
that of a pattern and its inverse, equal half of white, whatever the pattern. All patterns along x together thus give
one picture of the scene, those along y another. They are compared if all of one axis is shown before all of the other.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isqrt, sqrt

import numpy as np
from numpy.typing import NDArray

from calib.numerics import MANY_PIXELS, STRIP_ROWS, Floats, Floats32, Ints, Window, compiled, in_slices
from scanner.decoding.coordinates import CodeImages
from scanner.decoding.motion.motion_estimate import LEAST_PX, MotionCourse, MotionEstimate, MotionVerdict
from scanner.decoding.motion.rigid_motion import PER_DEVICE, CoordinateShift, turns_px
from scanner.decoding.motion.scene_motion import BORDER, SCENE, LitScene, Pictures, SceneRegistration, part_around
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


# Pictures are reduced to as few pixels as this at least: they tell where pictures of so many pixels do, and light that
# is added up is not lost.
_LEAST_PIXELS = 1_000_000


@dataclass(frozen=True)
class EvenLight:
    """The scene as it looks evenly lit: weighted means of frames, in a part of the image, reduced by a whole number."""

    code_images: CodeImages
    part: Window
    """Of the image, in whole reduced pixels."""
    scale: int
    """Camera pixels along a reduced one."""

    def means(
        self,
        groups: tuple[Mapping[int, float], Mapping[int, float]],
        pairs: Sequence[tuple[int, int]] = (),
        pixels: Sequence[Ints] = (),
    ) -> tuple[Pictures, tuple[Floats32, ...]]:
        """Return the means (H, W) of two groups of frames, by number, with their weights; and, for each set of reduced
        pixels, ascending flat indices (P,), the means (pairs, P) of pairs of frames there.
        """
        (rows, columns), scale = self.part, self.scale
        height, width = ((part.stop - part.start) // scale for part in self.part)
        pictures = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
        levels = tuple(np.empty((len(pairs), len(some)), np.float32) for some in pixels)
        needed = {frame for frames in (*groups, *pairs) for frame in frames}

        def add(strip: slice) -> None:
            there = slice(rows.start + scale * strip.start, rows.start + scale * strip.stop), columns
            frames, places, corner = self.code_images.frames.stacked(there, needed)
            for group, picture in zip(groups, pictures, strict=True):
                numbers = np.array([places[frame] for frame in group], np.int64)
                weights = np.array([*group.values()], np.float32) / np.float32(scale**2)
                _add_up(frames, numbers, weights, corner, scale, picture[strip])
            of_pairs = np.array([[places[frame] for frame in pair] for pair in pairs], np.int64).reshape(-1, 2)
            for some, means in zip(pixels, levels, strict=True):
                own = slice(*np.searchsorted(some, (strip.start * width, strip.stop * width)).tolist())
                row, column = np.divmod(some[own] - strip.start * width, width)
                place = np.stack([corner[0] + scale * row, corner[1] + scale * column])
                _note_means(frames, of_pairs, place, means[:, own])

        in_slices(height, max(1, STRIP_ROWS // scale), add)
        return pictures, levels


@compiled
def _add_up(
    frames: NDArray[np.generic], places: Ints, weights: Floats32, corner: tuple[int, int], scale: int, picture: Floats32
) -> None:
    """Add up the weighted frames at some places of (N, ...), from a corner on, over squares of `scale` px, to a picture
    (H, W).
    """
    top, left = corner
    height, width = picture.shape
    total = np.empty(scale * width, np.float32)
    for row in range(height):
        total[:] = 0.0
        for k in range(len(places)):
            for y in range(top + scale * row, top + scale * (row + 1)):
                levels, weight = frames[places[k], y, left : left + scale * width], weights[k]
                for i in range(scale * width):
                    total[i] += weight * np.float32(levels[i])
        for x in range(scale):
            for i in range(width):
                picture[row, i] += total[scale * i + x]


@compiled
def _note_means(frames: NDArray[np.generic], pairs: Ints, place: Ints, means: Floats32) -> None:
    """Note the means (pairs, P) of pairs of frames (N, ...) at the rows and columns `place` (2, P)."""
    for pair in range(len(pairs)):
        pattern, inverse = frames[pairs[pair, 0]], frames[pairs[pair, 1]]
        for k in range(place.shape[1]):
            row, column = place[0, k], place[1, k]
            means[pair, k] = np.float32(0.5) * (np.float32(pattern[row, column]) + np.float32(inverse[row, column]))


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


def time_of_change(levels: Floats32, first: int, stripes: Sequence[float]) -> TimeOfChange | None:
    """Locate a single change of K pictures with these `levels` (K, P), compared with a change after the `first` few.

    `stripes`: stripe width of the pair that each picture is the sum of. None if sorting the pictures by stripe width
    separates them better than sorting by time: stripes that were sharpened or rescaled do not add up to even light. A
    change of overall brightness is ignored.
    """
    count = len(levels)
    away = levels - levels.mean(axis=1, keepdims=True)
    mean = away.mean(axis=0)
    away -= np.outer(away @ mean / max(float(mean @ mean), 1e-12), mean)  # the mean may be even itself
    products = (away @ away.T).astype(np.float64)
    between = _between_groups(products)
    by_width = np.argsort(stripes, kind="stable")
    if between.max() < _between_groups(products[np.ix_(by_width, by_width)]).max():
        return None
    best = int(np.argmax(between)) + 1
    # Either picture next to the change may have been taken during it.
    before, after = (part.mean(axis=0) for part in (away[: max(best - 1, 1)], away[min(best + 1, count - 1) :]))
    change = after - before
    done = (away @ change - before @ change) / max(float(change @ change), 1e-12)
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

    share: float
    sigma: float
    first: int
    last: int


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
    first, second = halves
    shares = np.array([axis.axis == second.axis.axis for axis in plan.axes], np.float64)
    scale = max(1, isqrt(height * width // _LEAST_PIXELS))
    rows, columns = part = part_around(projector_px, scale)
    scene = LitScene(
        np.ascontiguousarray(projector_px[part][scale // 2 :: scale, scale // 2 :: scale]),
        # Codes alone give coordinates in steps.
        0.0 if plan.fringes else max(axis.cell for axis in plan.axes),
        shares,
        projector_size,
        (width // scale, height // scale),
        (columns.start // scale, rows.start // scale),
        scale,
    )
    light = EvenLight(code_images, part, scale)
    pairs = _pairs_in_order(plan, halves)
    pictures, levels = light.means((first.weights, second.weights), pairs, _compared_pixels(scene) if pairs else ())
    fit, timing = SceneRegistration(pictures, scene).fit(), _Timing(1.0, 0.0, first.last, second.first)
    for moment in _within_halves(halves, pairs, levels):
        groups = [
            dict.fromkeys((frame for number in group for frame in pairs[number]), 0.5 / len(group))
            for group in (moment.before, moment.after)
        ]
        of_other = SceneRegistration(light.means((groups[0], groups[1]))[0], scene).fit()
        # The pictures of the halves mix before and after, so that the motion looks smaller there.
        larger = np.hypot(*turns_px(of_other.motion)) > np.hypot(*turns_px(fit.motion))
        if larger and of_other.significance > SIGNIFICANT_SIGMAS:
            fit, timing = of_other, _timing_of(halves, pairs, plan, moment)
    _, camera_px = turns_px(fit.motion)
    shift = CoordinateShift(np.outer(shares, timing.share * fit.motion), *sizes)
    size_px = _typical_px(shift, scene)
    largest_px = _LARGEST_PX if camera_px < _LARGEST_OF_CAMERA_PX else 0.0
    verdict = MotionVerdict.of(
        size_px, largest_px, significant=fit.significance > SIGNIFICANT_SIGMAS and size_px > LEAST_PX
    )
    spread = [
        CoordinateShift(np.outer(shares, part), *sizes) for part in _independent(timing.share**2 * fit.covariance)
    ]
    turns = np.diag(fit.covariance).reshape(-1, PER_DEVICE)[:, :2]  # pan and tilt of either device
    between = MotionEstimate(
        motion=fit.motion,
        course=MotionCourse.BUMP,
        verdict=verdict,
        first=plan.repeats * timing.first,
        last=plan.repeats * timing.last,
        size_px=size_px,
        explained=1.0,
        shift=shift,
        alternatives=tuple(
            CoordinateShift(np.outer(shares, (timing.share + error) * fit.motion), *sizes)
            for error in ((-timing.sigma, timing.sigma) if timing.sigma else ())
        ),
        unseen=tuple([*spread, shift] if verdict is MotionVerdict.NONE else spread),
        turn_sigma_px=sqrt(turns.max()),
        largest_px=largest_px,
    )
    if within is None or not within.is_significant or (between.is_significant and size_px > within.size_px):
        return between
    return replace(within, unseen=between.unseen, turn_sigma_px=between.turn_sigma_px)


def _pairs_in_order(plan: SequencePlan, halves: tuple[Half, Half]) -> list[tuple[int, int]]:
    """Return the frames of pattern and inverse, for codes alone, in order of display.

    If the two differ in brightness, stripes remain in their mean, which move with neither device.
    """
    pairs = [pair for half in halves for pair in pairs_of(half.axis).values()]
    return sorted(pairs, key=lambda pair: sorted(map(plan.shown.index, pair)))


def _compared_pixels(scene: LitScene) -> list[Ints]:
    """Return the reduced pixels, flat indices (P,), at which pictures of code pairs are compared: of the scene, then of
    the border; none where there are too few.
    """
    labels, groups = scene.at_rest, []
    for label in (SCENE, BORDER):
        count = np.count_nonzero(labels == label)
        if count >= FEWEST_PIXELS:
            # Pixels of whole rows are next to each other in memory.
            step = -(-count // MANY_PIXELS)
            row, column = np.nonzero(labels[::step] == label)
            groups.append(step * row * labels.shape[1] + column)
    return groups


def _within_halves(
    halves: tuple[Half, Half], pairs: Sequence[tuple[int, int]], levels: Sequence[Floats32]
) -> Iterator[TimeOfChange]:
    """Yield the times, other than between the halves, at which pictures of code pairs changed: the scene, then the
    border, of which these are the `levels` (pairs, P).
    """
    found_groups = set()  # scene and border mostly agree
    first = len(pairs_of(halves[0].axis))
    # Relative widths: the stripes of a bit are half as wide as those of the coarser one before it.
    bits = {pair: (half.axis, bit) for half in halves for bit, pair in pairs_of(half.axis).items()}
    stripes = [axis.cell * 2.0 ** (max(pairs_of(axis)) - bit) for axis, bit in (bits[pair] for pair in pairs)]
    for of_part in levels:
        moment = time_of_change(of_part, first, stripes)
        if moment is None or min(len(moment.before), len(moment.after)) < _FEWEST_PAIRS:
            continue
        groups = moment.before, moment.after
        if AS_GOOD * moment.gained > 1 and groups not in found_groups:
            found_groups.add(groups)
            yield moment


def _timing_of(
    halves: tuple[Half, Half], pairs: Sequence[tuple[int, int]], plan: SequencePlan, moment: TimeOfChange
) -> _Timing:
    """Return the effect of a change at this moment on the coordinates: half of the edges of a code belong to its finest
    bit.
    """
    done = dict(zip(pairs, moment.done.tolist(), strict=True))
    of_halves = []
    for half in halves:
        edges = {pair: 2.0**bit for bit, pair in pairs_of(half.axis).items()}
        of_halves.append(sum(count * done[pair] for pair, count in edges.items()) / sum(edges.values()))
    before, after = pairs[max(moment.before)], pairs[min(moment.after)]
    mixed = max(sqrt(share * (1 - share)) for share in of_halves)
    return _Timing(
        of_halves[1] - of_halves[0],
        _MIXED * mixed,
        max(map(plan.shown.index, before)),
        min(map(plan.shown.index, after)),
    )


def _independent(covariance: Floats) -> Floats:
    """Factor a covariance into independent vectors (8, 8), one per row."""
    values, vectors = np.linalg.eigh(covariance)
    rows: Floats = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    return rows


def _typical_px(shift: CoordinateShift, scene: LitScene) -> float:
    """Return the root mean square shift of the coordinates over the known tiles."""
    planes, known, scale = scene.planes, scene.planes.known, scene.scale
    centre = scale * (scene.centre[known] + 0.5) - 0.5
    shifts = shift.shifts(centre, planes.projector_px[known], planes.gradient[known] / scale)
    return float(np.sqrt(np.mean(np.sum(shifts**2, axis=1)))) if len(shifts) else 0.0
