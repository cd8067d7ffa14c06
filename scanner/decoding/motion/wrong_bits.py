"""Detection of wrong bits from the coordinates: something that passes, or its shadow, flips bits while codes are shown.

Fringes taken before or after still give the position within a period. It therefore continues from one segment of a
surface to the next up to a whole number of periods, except at the edges of surfaces. Segments are merged across their
borders, longest border first, with a weighted union-find that tracks relative periods, as in region-wise phase
unwrapping. Segments that disagree with most of their surface are wrong: their period slipped.
"""

from collections.abc import Sequence
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, Floats32, Ints, compiled, median
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import BROKEN, MaskReason
from scanner.decoding.motion.inconsistent_pixels import patches
from scanner.decoding.motion.photometric_constraints import STATIC_SHARE
from scanner.decoding.samples import GridSample
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import HALF

# Widest gap, in undecoded pixels, across which a surface is extrapolated; pixels over which its slope is measured.
_WIDEST_GAP, _SLOPE_PX = 8, 4
# A border ties two segments if their positions continue within this part of a period at more than half of its places,
# and at this many at least.
_GOES_ON, _FEWEST = 0.08, 4
# A surface smaller than this share of all surfaces is too small to decide its own period.
_SMALLEST = 0.001
# Segments, and how many periods the second one is ahead.
_Border = tuple[int, int, int]
# Neighbours on a surface are not farther apart than this many cells, nor this many times the usual distance.
_FAR_CELLS, _TIMES_USUAL = 1.4, 4.0


def mask_wrong_bits(plan: SequencePlan, maps: Maps, moved: Bools | None) -> None:
    """Mask, in place, pixels with wrong bits; `moved` (H, W): where something is known to have moved, or None.

    With fringes, these are the pixels with a period slip relative to their surface. With codes alone, they are patches
    whose pixels are inconsistent or jump, unless such patches cover most of the picture.
    """
    wrong = in_wrong_cycles(plan, maps) if plan.fringes else _in_broken_patches(plan, maps)
    wrong &= maps.reason != MaskReason.DARK
    maps.reason[wrong] = np.uint8(MaskReason.MOVED)
    # Isolated pixels on the border of another period would look like a code that does not belong to the fringes.
    near = cv2.dilate(wrong.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=2) > 0
    maps.projector_px[wrong | (maps.reason != MaskReason.KEPT) & (near if moved is None else near | moved)] = np.nan


def _in_broken_patches(plan: SequencePlan, maps: Maps) -> Bools:
    grid = GridSample((maps.reason.shape[0], maps.reason.shape[1]))
    reason = grid.of(maps.reason)
    broken = np.isin(reason, BROKEN) | _jumps(plan, grid, maps)
    lit = broken | (reason == MaskReason.KEPT)
    broken_patches = patches(broken, lit)
    if np.count_nonzero(lit & ~broken_patches) < STATIC_SHARE * np.count_nonzero(lit):
        return np.zeros_like(maps.reason, np.bool_)
    return grid.at_full_size(broken_patches)


def _jumps(plan: SequencePlan, grid: GridSample, maps: Maps) -> Bools:
    """Return pixels of the grid (h, w) that are farther from their neighbour than cells explain.

    Pixels on a steep surface are not counted, whose steps are all alike.
    """
    jumping = np.zeros(grid.of(maps.reason).shape, np.bool_)
    for number, axis in enumerate(plan.axes):
        value = cast(Floats32, grid.of(maps.projector_px[..., number]))
        for jumps, at in ((jumping, value), (jumping.T, value.T)):
            steps = np.diff(at, axis=0)
            far = _is_far(np.abs(steps), axis.cell) & _is_far(_step_change(steps), axis.cell)
            jumps[:-1] |= far
            jumps[1:] |= far
    return jumping


def _is_far(distance: Floats32, cell: float) -> Bools:
    """Return which distances (h, w) are far; NaN, unknown, is not."""
    known = np.isfinite(distance)
    usual = median(distance[known]) if known.any() else 0.0
    return known & (distance > max(_FAR_CELLS * cell, _TIMES_USUAL * usual))


def _step_change(steps: Floats32) -> Floats32:
    """Return the difference of each step (h, w) between rows from the more similar one of the steps before and after
    it.

    It is the step itself if both are unknown, and NaN if the step is.
    """
    neighbours = np.full((2, *steps.shape), np.nan, np.float32)
    neighbours[0, 1:], neighbours[1, :-1] = steps[:-1], steps[1:]
    result: Floats32 = np.fmin(*np.abs(steps - neighbours))
    return np.where(np.isnan(result), np.abs(steps), result)


def in_wrong_cycles(plan: SequencePlan, maps: Maps) -> Bools:
    """Return the pixels (H, W) with a period slip along either axis."""
    wrong = np.zeros(maps.reason.shape, np.bool_)
    for number, axis in enumerate(plan.axes):
        if axis.codes and axis.fringes:
            value = np.ascontiguousarray(maps.projector_px[..., number]) / np.float32(axis.fringes[-1].period)
            wrong |= _wrong_along(value)
    return wrong


def _wrong_along(position: Floats32) -> Bools:
    """Return the pixels (H, W) with a period slip, from positions (H, W) in periods, NaN where unknown."""
    count, labels = cv2.connectedComponents(_without_jumps(position).astype(np.uint8), connectivity=4)
    segment = cast(Ints, labels)
    area = np.bincount(segment.reshape(-1), minlength=count)
    area[0] = 0
    tree, ahead = _merged(count, _borders(position, segment))
    cycle, cycles = np.unique(np.stack([tree, ahead]), axis=1, return_inverse=True)
    size = np.bincount(cycles.reshape(-1), area)
    largest = np.full(count, _SMALLEST * area.sum())
    np.maximum.at(largest, cycle[0], size)
    wrong = size[cycles.reshape(-1)] < largest[tree]
    wrong[0] = False
    return cast(Bools, wrong[segment])


def _without_jumps(position: Floats32) -> Bools:
    """Return the pixels (H, W) that are less than half a period from all their neighbours."""
    known: Bools = np.isfinite(position)
    for here, there in (np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:]):
        far = np.abs(position[here] - position[there]) > HALF
        known[here] &= ~far
        known[there] &= ~far
    return known


def _borders(position: Floats32, segment: Ints) -> list[_Border]:
    """Return the borders on whose relative period most places agree, longest first."""
    crossings = []
    for turned in (False, True):
        values = np.ascontiguousarray(position.T if turned else position)
        labels = np.ascontiguousarray(segment.T if turned else segment)
        first, second = np.empty((2, values.size // 2 + 1), np.int32)
        apart = np.empty(len(first), np.float32)
        crossed = _record_crossings(values, labels, first, second, apart)
        crossings.append((first[:crossed], second[:crossed], apart[:crossed]))
    first, second, apart = (np.concatenate(parts) for parts in zip(*crossings, strict=True))
    apart = np.where(first < second, apart, -apart)
    first, second = np.minimum(first, second), np.maximum(first, second)
    cycles = np.rint(apart).astype(np.int32)
    _, border, all_places = np.unique(np.stack([first, second]), axis=1, return_inverse=True, return_counts=True)
    on = np.abs(apart - cycles) < _GOES_ON
    ties, at, count = np.unique(np.stack([first, second, cycles])[:, on], axis=1, return_index=True, return_counts=True)
    whole = all_places[border.reshape(-1)[on][at]]
    agreed = (count >= _FEWEST) & (count > HALF * whole)
    longest_first = np.argsort(-count[agreed], kind="stable")
    return [*map(tuple, ties[:, agreed][:, longest_first].T.tolist())]


@compiled
def _record_crossings(position: Floats32, segment: Ints, first: Ints, second: Ints, apart: Floats32) -> int:
    """Record where lines (lines, P) cross from one segment into another, and the step there beyond that of the local
    slope.
    """
    crossed = 0
    for line in range(position.shape[0]):
        last = -1
        for place in range(position.shape[1]):
            if segment[line, place] == 0:
                continue
            if last >= 0 and segment[line, place] != segment[line, last] and place - last <= _WIDEST_GAP:
                back = ahead = 0
                while back < min(_SLOPE_PX, last) and segment[line, last - back - 1] == segment[line, last]:
                    back += 1
                while (
                    ahead < min(_SLOPE_PX, position.shape[1] - 1 - place)
                    and segment[line, place + ahead + 1] == segment[line, place]
                ):
                    ahead += 1
                if back + ahead > 0:
                    rises = position[line, last] - position[line, last - back]
                    rises += position[line, place + ahead] - position[line, place]
                    first[crossed], second[crossed] = segment[line, last], segment[line, place]
                    steps = rises / (back + ahead) * (place - last)
                    apart[crossed] = position[line, place] - position[line, last] - steps
                    crossed += 1
            last = place
    return crossed


def _merged(count: int, borders: Sequence[_Border]) -> tuple[Ints, Ints]:
    """Return for each segment the root of its surface, and how many periods it is ahead of the root, (count,) each."""
    parent, ahead = list(range(count)), [0] * count

    def root(segment: int) -> tuple[int, int]:
        cycles, way = 0, []
        while parent[segment] != segment:
            way.append(segment)
            cycles += ahead[segment]
            segment = parent[segment]
        total = cycles
        for passed in way:
            cycles, parent[passed], ahead[passed] = cycles - ahead[passed], segment, cycles
        return segment, total

    for first, second, cycles in borders:
        (root_of_first, of_first), (root_of_second, of_second) = root(first), root(second)
        if root_of_first != root_of_second:
            parent[root_of_second], ahead[root_of_second] = root_of_first, of_first + cycles - of_second
    roots = np.array([root(segment) for segment in range(count)])
    return roots[:, 0], roots[:, 1]
