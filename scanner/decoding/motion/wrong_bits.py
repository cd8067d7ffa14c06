"""Bits that something passing, or its shadow, flips while codes are shown: found, and decided by the surface.

Fringes taken before or after still give the position within a period. It therefore continues from one segment of a
surface to the next up to a whole number of periods, except at the edges of surfaces. Segments are merged across their
borders, longest border first, with a weighted union-find that tracks relative periods, as in region-wise phase
unwrapping. Segments that disagree with most of their surface are wrong: their period slipped.

A corrupted bit of a Gray code leaves a choice of two cells, which are mirror images of each other within the block of
cells that share all coarser bits. Over a surface one of them grows in the direction in which all coordinates of the
axis grow, the other one in the opposite direction. Pixels where that is clear, and those at which nothing moved, decide
the others around them: the right cell lies in the plane of its neighbours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, Floats32, Image, Ints, Words, compiled, median
from scanner.decoding.codes import CodeWords, cell_numbers
from scanner.decoding.coordinates import CodeImages, CoordinateMap
from scanner.decoding.light import STATIC_SHARE, GridSample
from scanner.decoding.mask_reasons import BROKEN, MaskReason
from scanner.decoding.motion.inconsistent_pixels import InconsistentPixels, patches
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEW, FEWEST_PIXELS, HALF

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


def mask_wrong_bits(plan: SequencePlan, maps: CoordinateMap, moved: Bools | None) -> CoordinateMap:
    """Return the map with the pixels masked that have wrong bits.

    `moved` (H, W): where something is known to have moved, or None. With fringes, wrong bits are period slips relative
    to the surface around; with codes alone, patches that are inconsistent or jump, unless these cover most of it.
    """
    wrong = in_wrong_cycles(plan, maps) if plan.fringes else _in_broken_patches(plan, maps)
    wrong &= ~maps.masked_as(MaskReason.DARK)
    masked = maps.masked(wrong, MaskReason.MOVED)
    # Isolated pixels on the border of another period would look like a code that does not belong to the fringes.
    near = cv2.dilate(wrong.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=2) > 0
    return masked.without(wrong | ~masked.masked_as(MaskReason.KEPT) & (near if moved is None else near | moved))


def _in_broken_patches(plan: SequencePlan, maps: CoordinateMap) -> Bools:
    grid = GridSample((maps.reason.shape[0], maps.reason.shape[1]))
    reason = grid.of(maps.reason)
    broken = np.isin(reason, BROKEN) | _jumps(plan, grid, maps)
    lit = broken | (reason == MaskReason.KEPT)
    broken_patches = patches(broken, lit)
    if np.count_nonzero(lit & ~broken_patches) < STATIC_SHARE * np.count_nonzero(lit):
        return np.zeros_like(maps.reason, np.bool_)
    return grid.at_full_size(broken_patches)


def _jumps(plan: SequencePlan, grid: GridSample, maps: CoordinateMap) -> Bools:
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


def in_wrong_cycles(plan: SequencePlan, maps: CoordinateMap) -> Bools:
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


# Cells are compared over this many pixels to either side, and their growth is averaged over a window of this side.
_REACH_PX, _WINDOW_PX = 2, 5
# Side of the window of a plane, and how often it is fitted: decided pixels spread by half a window each time.
_PLANE_PX, _ROUNDS = 9, 8
# Largest distance of a cell from the plane of its neighbours: half a cell for each of them, and as much for a bend.
_NEAR_CELLS = 1.5
_MOST_CORRUPTED = 2  # bits of a pixel: one that is hidden longer stays corrupted


def repair_codes(code_images: CodeImages, inconsistent: InconsistentPixels | None) -> tuple[CodeImages, Bools | None]:
    """Return the images with corrupted bits of plain Gray codes decided, and the pixels (H, W) that remain corrupted,
    None if nothing moved.
    """
    if inconsistent is None:
        return code_images, None
    unrepaired, decided = (np.zeros(code_images.white.shape, np.bool_) for _ in range(2))
    corrupted = inconsistent.corrupted_by_frames
    codes = list(code_images.codes)
    for number, code_words in enumerate(codes):
        by_bit = {bit: corrupted[pair] for bit, pair in code_words.code.pairs.items() if pair in corrupted}
        if by_bit and code_words.code.base is None:
            frames = dict(code_images.frames.by_number(numbers=code_words.code.frames))
            codes[number], repaired = repair_bits(code_words, by_bit, frames, inconsistent.static)
            unrepaired |= np.logical_or.reduce(list(by_bit.values())) & ~repaired
            decided |= repaired
    return code_images.decoded_as(codes), inconsistent.corrupted & (unrepaired | ~decided)


def repair_bits(
    code_words: CodeWords, corrupted: Mapping[int, Bools], frames: Mapping[int, Image], static: Bools
) -> tuple[CodeWords, Bools]:
    """Return a plain Gray code with corrupted bits decided, and the pixels (H, W) at which all of them are.

    `corrupted`: by bit, the pixels (H, W) at which its frames are corrupted. `frames`: by number, those of the code (H,
    W). `static` (H, W): lit pixels at which nothing moved.
    """
    everywhere = np.logical_or.reduce(list(corrupted.values()))
    column, top, width, height = cv2.boundingRect((everywhere | static).view(np.uint8))
    part = slice(top, top + height), slice(column, column + width)
    decided, words = np.zeros(static.shape, np.bool_), code_words.words.copy()
    decision = _decided_words(
        code_words, {bit: where[part] for bit, where in corrupted.items()}, static[part], words[part]
    )
    if decision is None:
        return code_words, decided
    decided[part], words[part] = decision
    least = np.full_like(code_words.least, np.iinfo(code_words.least.dtype).max)
    for bit, (normal, inverse) in code_words.code.pairs.items():
        where = corrupted.get(bit, np.zeros_like(decided))
        # A corrupted frame gives no edge to interpolate from.
        bit_image = (words >> (code_words.code.bits - 1 - bit) & 1).astype(np.uint8)
        decided &= ~(where & (cv2.morphologyEx(bit_image, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0))
        contrast = cv2.absdiff(frames[normal], frames[inverse]).astype(least.dtype)
        np.minimum(least, contrast, out=least, where=~where)
    return code_words.decided(decided, words, least), decided


def _decided_words(
    code_words: CodeWords, corrupted: Mapping[int, Bools], static: Bools, words: Words
) -> tuple[Bools, Words] | None:
    """Return where (h, w) corrupted bits are decided, and the words (h, w); None if the code grows in no one
    direction.
    """
    number = cell_numbers(words).astype(np.float32)
    growth = _Growth.of(number, static)
    if growth is None:
        return None
    times = np.zeros(static.shape, np.uint8)
    for where in corrupted.values():
        times += where
    few: Bools = (times > 0) & (times <= _MOST_CORRUPTED)
    decided, flips = np.zeros_like(static), [(0, few)]
    for bit, where in corrupted.items():
        place = code_words.code.bits - 1 - bit
        mask = words.dtype.type(1 << place)
        unset, set_ = cell_numbers(words & ~mask), cell_numbers(words | mask)
        grows, clear = growth.of_choice(unset, 2 << place, (times == 0) | (times == 1) & where)
        clear &= where & (times == 1)
        number[clear] = np.where(grows, unset, set_)[clear]
        decided |= clear
        more = ((mask | bits, where & possible) for bits, possible in flips if bits.bit_count() < _MOST_CORRUPTED)
        flips += [(int(both), possible) for both, possible in more if possible.any()]
    for _ in range(_ROUNDS):
        decided = _nearest(words, flips, _planes(number, static | decided), number)
        decided &= ~growth.contradicts(number, static | decided)
    cells = number.astype(words.dtype)
    return decided, np.where(decided, cells ^ cells >> 1, words)


def _nearest(words: Words, flips: Sequence[tuple[int, Bools]], expected: Floats32, number: Floats32) -> Bools:
    """Set `number` (h, w), in place, to the possible one that is nearest to the expected one; return where it is clear.

    `flips`: bits of the `words` (h, w) that may be wrong, with the pixels (h, w) at which they may. `expected` (h, w):
    NaN where unknown.
    """
    best, next_best = (np.full(number.shape, np.inf, np.float32) for _ in range(2))
    nearest = number.copy()
    for bits, possible in flips:
        candidate = cell_numbers(words ^ words.dtype.type(bits)).astype(np.float32)
        error = np.where(possible, np.abs(candidate - expected), np.float32(np.inf))
        nearer = error < best
        next_best = np.where(nearer, best, np.minimum(next_best, error))
        np.copyto(best, error, where=nearer)
        np.copyto(nearest, candidate, where=nearer)
    clear: Bools = (best < _NEAR_CELLS) & (next_best > 2 * best + 1)
    np.copyto(number, nearest, where=clear)
    return clear


@dataclass(frozen=True)
class _Growth:
    """By how many `cells` a coordinate grows over twice the reach: along image columns if `down`, or along rows."""

    cells: float
    down: bool

    @classmethod
    def of(cls, number: Floats32, static: Bools) -> "_Growth | None":
        """Measure it at `static` pixels (h, w); None if they are few, or do not nearly all grow in one direction."""
        growths = []
        for down in (False, True):
            steps = _steps(np.where(static, number, np.float32(np.nan)), down=down)
            steps = steps[np.isfinite(steps)]
            if len(steps) >= FEWEST_PIXELS:
                cells = float(median(steps))
                if abs(cells) >= 1 and np.mean(steps * cells < 0) < FEW:
                    growths.append(cls(cells, down))
        return max(growths, key=lambda growth: abs(growth.cells), default=None)

    def of_choice(self, number: Words, block: int, usable: Bools) -> tuple[Bools, Bools]:
        """Return where (h, w) the cells `number` grow like this within blocks of so many cells, and where it is clear.

        Near the middle of a block, where a cell and its mirror image are close, it is not. `usable` (h, w): where no
        other bit is corrupted.
        """
        number = number.astype(np.uint32)
        place = np.where(usable, number % block, np.nan).astype(np.float32)
        same_block = _steps((number // block).astype(np.float32), down=self.down) == 0
        growth = self._in_windows(np.where(same_block, _steps(place, down=self.down), np.float32(np.nan)))
        within_window = abs(self.cells) * (1 + _WINDOW_PX / (2 * _REACH_PX))
        return growth > 0, (np.abs(growth) > HALF) & (np.abs(block - 1 - 2 * place) > within_window)

    def contradicts(self, number: Floats32, known: Bools) -> Bools:
        """Return where (h, w) the known cells do not grow like this."""
        steps = _steps(np.where(known, number, np.float32(np.nan)), down=self.down)
        return self._in_windows(steps) < HALF

    def _in_windows(self, steps: Floats32) -> Floats32:
        """Return the mean of the known steps around each pixel (h, w), relative to these; NaN with few of them."""
        window, known = np.ones(_WINDOW_PX, np.float32), np.isfinite(steps)
        count = _filtered(known.astype(np.float32), window, window)
        total = _filtered(np.where(known, steps, np.float32(0)), window, window)
        mean = np.where(count >= _WINDOW_PX, total, np.nan) / (np.maximum(count, 1) * self.cells)
        return mean.astype(np.float32)


def _steps(values: Floats32, *, down: bool) -> Floats32:
    """Return the difference between the pixels at the reach on either side of each, (h, w); NaN at the border."""
    steps = np.full_like(values, np.nan)
    along, of = (steps.T, values.T) if down else (steps, values)
    along[:, _REACH_PX:-_REACH_PX] = of[:, 2 * _REACH_PX :] - of[:, : -2 * _REACH_PX]
    return steps


def _planes(values: Floats32, known: Bools) -> Floats32:
    """Return the value at each pixel (h, w) of the plane through the `known` values around it; NaN with few of them."""
    weight = known.astype(np.float32)
    weighted = weight * values
    flat = np.ones(_PLANE_PX, np.float32)
    slope = np.arange(_PLANE_PX, dtype=np.float32) - _PLANE_PX // 2
    count, x, y = (_filtered(weight, *by) for by in ((flat, flat), (slope, flat), (flat, slope)))
    xx, xy, yy = (_filtered(weight, *by) for by in ((slope**2, flat), (slope, slope), (flat, slope**2)))
    z, xz, yz = (_filtered(weighted, *by) for by in ((flat, flat), (slope, flat), (flat, slope)))
    # Cramer's rule for the constant of the normal equations.
    minors = xx * yy - xy * xy, x * yy - xy * y, x * xy - xx * y
    determinant = count * minors[0] - x * minors[1] + y * minors[2]
    enough = (count >= _PLANE_PX) & (determinant > count)
    plane: Floats32 = np.where(enough, z * minors[0] - xz * minors[1] + yz * minors[2], np.float32(np.nan))
    plane /= np.where(enough, determinant, 1)
    return plane


def _filtered(values: Floats32, along: Floats32, down: Floats32) -> Floats32:
    """Return the sums over the window around each pixel, weighted along rows and columns."""
    return cast(Floats32, cv2.sepFilter2D(values, cv2.CV_32F, along, down, borderType=cv2.BORDER_CONSTANT))
