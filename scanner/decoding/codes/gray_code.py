"""Gray codes: fold the bits of each pixel into code words, and these into the interval of the projector axis that they
determine.

Where only codes tell a coordinate, the camera pixels of each projector cell are averaged: all of them see the same
small patch, whose centre is known better than any of them.
"""

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from calib.numerics import Bools, Floats, Floats32, Image, Ints, Words, compiled
from scanner.decoding.mask_reasons import PixelFlags, Reasons
from scanner.decoding.sequence_plan import FINE_BITS, AxisPlan, GrayCode

_HALF, _ONE, _NOTHING = np.float32(0.5), np.float32(1), np.uint8(0)


class CodeWords:
    """The code word of each pixel, with the contrast of its bits.

    `words` (H, W): of the plain Gray code, bit 0 in place bits − 1, as in the pattern. `least` and `contrast` (H, W):
    smallest and largest |bright − dark| among the bits, in grey levels. `contrast` is None where fringes show what is
    lit. Without fringes, each of the finest bits has its own contrast image in `fine`, by bit, and is not included in
    `least`: whether the camera resolves it is decided later. It may then become `optional`.
    """

    def __init__(self, code: GrayCode, shape: tuple[int, int], dtype: np.dtype[Any], *, contrast: bool) -> None:
        self.code = code
        self.contrast: Image | None = np.zeros(shape, dtype) if contrast else None
        self.least: Image = np.full(shape, np.iinfo(dtype).max, dtype)
        keeps_fine = contrast and code.base is None and code.bits > FINE_BITS
        fine = range(code.bits - FINE_BITS, code.bits) if keeps_fine else ()
        self.fine: dict[int, Image] = {bit: self.least.copy() for bit in fine if code.frames_of([bit])}
        self.optional: dict[int, Image] = {}
        self._least_of_others = self.least
        words = next(kind for kind in (np.uint8, np.uint16, np.uint32) if np.iinfo(kind).bits >= code.bits)
        self.words: Words = np.full(shape, code.constant, words)

    def fill(self, frames: Mapping[int, Image], thresholds: Mapping[int, Image], rows: slice = slice(None)) -> None:
        """Fill in some rows, from their frames, and from the thresholds of bits without an inverse."""
        words = self.words[rows]
        for bit, bright, dark in compared(self.code, frames, thresholds):
            is_set = cv2.compare(bright, dark, cv2.CMP_GT).view(np.int8)  # all bits are set, or none
            words |= is_set.astype(words.dtype) & words.dtype.type(1 << self.code.bits - 1 - bit)
            contrast = cv2.absdiff(bright, dark)
            if bit in self.code.unpaired:
                contrast = cv2.add(contrast, contrast)
            least = self.fine.get(bit, self.least)[rows]
            np.minimum(least, contrast, out=least)
            if self.contrast is not None:
                np.maximum(self.contrast[rows], contrast, out=self.contrast[rows])
        words[:] = self.code.relative_to_base(words)

    def with_contrast(self, contrast: Image) -> "CodeWords":
        """Return the code words with another largest contrast (H, W)."""
        changed = copy(self)
        changed.contrast = contrast
        return changed

    def release_contrasts(self) -> None:
        """Let go of everything but the words, as large as the frames of a dozen bits."""
        self.contrast, self.fine, self.optional = None, {}, {}
        self.least = self._least_of_others = np.empty((0, 0), self.least.dtype)

    @property
    def least_needed(self) -> Image:
        """(H, W): the smallest contrast among the bits that are not optional."""
        return self._least_of_others if self.optional else self.least

    def decided(self, where: Bools, words: Words, least: Image) -> "CodeWords":
        """Return code words with other words and another smallest contrast (H, W) in some pixels (H, W)."""
        changed = copy(self)
        changed.words = np.where(where, words, self.words)
        changed.least = np.where(where, least, self.least)
        is_same = self._least_of_others is self.least
        changed._least_of_others = changed.least if is_same else np.where(where, least, self._least_of_others)
        changed.optional = {
            bit: np.where(where, np.maximum(contrast, least), contrast) for bit, contrast in self.optional.items()
        }
        return changed

    def least_at(self, bits: int, pixels: Ints | None = None) -> Image:
        """Return the smallest contrast of the coarsest `bits`: of all pixels (H, W), or at flat indices (P,)."""
        images = [self.least, *(image for bit, image in self.fine.items() if bit < bits)]
        if pixels is not None:
            images = [image.reshape(-1)[pixels] for image in images]
        least = images[0].copy()
        for image in images[1:]:
            np.minimum(least, image, out=least)
        return least

    def without_finest(self, count: int, *, optional: bool = False) -> "CodeWords":
        """Return the coarser code without its `count` finest bits; its `least` covers all its bits.

        `optional`: a pixel may lack some of the remaining fine bits.
        """
        coarser = copy(self)
        coarser.code, coarser.fine = self.code.without_finest(count), {}
        coarser.words = self.words >> self.words.dtype.type(count) if count else self.words
        kept = {bit: image for bit, image in self.fine.items() if bit < coarser.code.bits}
        coarser.least = self.least_at(coarser.code.bits)
        coarser.optional = {**coarser.optional, **(kept if optional else {})}
        if not coarser.optional:
            coarser._least_of_others = coarser.least  # and the coarser code holds no picture of the finer one
        return coarser


def compared(
    code: GrayCode, frames: Mapping[int, Image], thresholds: Mapping[int, Image]
) -> Iterator[tuple[int, Image, Image]]:
    """Yield each bit that was shown, with its bright and its dark image, from frames by index.

    A bit without an inverse is compared with its frame's threshold.
    """
    for bit in sorted({*code.normal, *code.inverse}):
        normal, inverse = code.normal.get(bit), code.inverse.get(bit)
        bright = thresholds[code.inverse[bit]] if normal is None else frames[normal]
        yield bit, bright, thresholds[code.normal[bit]] if inverse is None else frames[inverse]


@dataclass(frozen=True)
class Interval:
    """The interval of each of P pixels by its Gray codes, in projector pixels."""

    low: Floats32
    """(P,)"""
    high: Floats32
    """(P,)"""
    flags: Reasons
    """(P,): of `PixelFlags`. OUTSIDE: the code belongs to no projector pixel. CONTRADICTORY: the intervals of two codes
    do not overlap.
    """

    @property
    def centre(self) -> Floats32:
        """The middle of the interval."""
        return _HALF * (self.low + self.high)

    def variance(self, cell: float) -> Floats32:
        """Return that of a uniform distribution over the interval; where two codes' cells only touch, over a cell."""
        length = self.high - self.low
        return np.float32(1 / 12) * np.where(length > 0, length, np.float32(cell)) ** 2

    @property
    def possible(self) -> Bools:
        """True where the codes are neither outside nor contradictory."""
        possible: Bools = self.flags == 0
        return possible

    @property
    def contradictory(self) -> Bools:
        """True where the intervals of two codes do not overlap."""
        contradictory: Bools = self.flags & np.uint8(PixelFlags.CONTRADICTORY) != 0
        return contradictory


def interval_of(
    plan: AxisPlan, words: Sequence[Words], pixels: int, undecided: Mapping[int, Words] | None = None
) -> Interval:
    """Return the intersection of the intervals of all Gray codes of an axis; without codes the whole axis.

    `words` (P,): of each code. `undecided`: by code index, a mask (P,) of bits that are undecided at a pixel.
    """
    first, last = np.float32(-0.5), np.float32(plan.length - 0.5)
    low, high = np.full(pixels, first), np.full(pixels, last)
    flags = np.empty(pixels, np.uint8)
    for number, (code, of_code) in enumerate(zip(plan.codes, words, strict=True)):
        cell, before = np.float32(code.cell), np.float32(code.offset + 0.5)
        where = np.flatnonzero(undecided[number] if undecided and number in undecided else ())
        earlier = low[where], high[where]
        _narrow(of_code, cell, before, low, high)
        if undecided and len(where):
            start, end = _widened(of_code[where], undecided[number][where])
            low[where] = np.maximum(earlier[0], start * cell - before)
            high[where] = np.minimum(earlier[1], end * cell - before)
    # Blurred edges may leave a small gap between two codes' intervals.
    kinds = np.uint8(PixelFlags.OUTSIDE), np.uint8(PixelFlags.CONTRADICTORY)
    _settle(first, last, np.float32(plan.cell / 2), *kinds, low, high, flags)
    return Interval(low, high, flags)


def cell_numbers(words: Words) -> Words:
    """Convert Gray code words to cell numbers, of the same type: each bit is the exclusive or of itself and all higher
    bits.
    """
    numbers = words.copy()
    shift = 1
    while shift < 8 * words.itemsize:
        np.bitwise_xor(numbers, numbers >> shift, out=numbers)
        shift *= 2
    return numbers


def _widened(words: Words, undecided: Words) -> tuple[Floats32, Floats32]:
    """Return the first cell of each word (P,), and the one after the last, if some of its bits are undecided.

    A single undecided bit that separates two neighbouring cells leaves both. Otherwise the stripes of the bit are not
    resolved, and all cells that share the coarser bits are possible.
    """
    word, bits = words.astype(np.uint32), undecided.astype(np.uint32)
    number, alternative = (cell_numbers(words_of).astype(np.float32) for words_of in (word, word ^ bits))
    is_edge = (bits & (bits - np.uint32(1)) == 0) & (np.abs(alternative - number) == 1)
    size = np.exp2(np.floor(np.log2(bits)) + 1).astype(np.float32)
    start = np.where(is_edge, np.minimum(number, alternative), np.floor(number / size) * size)
    return start, start + np.where(is_edge, np.float32(2), size)


@compiled
def _narrow(words: Words, cell: np.float32, before: np.float32, low: Floats32, high: Floats32) -> None:
    """Intersect the intervals with the cell of each of the `words` (P,), decoded as in `cell_numbers`; the code begins
    `before` pixels before pixel 0.
    """
    for i in range(len(words)):
        number = np.uint32(words[i])
        number ^= number >> np.uint32(1)
        number ^= number >> np.uint32(2)
        number ^= number >> np.uint32(4)
        number ^= number >> np.uint32(8)
        number ^= number >> np.uint32(16)
        at = np.float32(np.int32(number))
        start, end, first, last = at * cell - before, (at + _ONE) * cell - before, low[i], high[i]
        low[i] = max(first, start)
        high[i] = min(last, end)


@compiled
def _settle(
    first: np.float32,
    last: np.float32,
    slack: np.float32,
    outside: np.uint8,
    contradictory: np.uint8,
    low: Floats32,
    high: Floats32,
    flags: Reasons,
) -> None:
    """Flag intervals outside `first` to `last`, and contradictory ones, which end before they
    begin; sort their ends.
    """
    for i in range(len(low)):
        start, end = low[i], high[i]
        beyond = outside if (start >= last) | (end <= first) else _NOTHING
        flags[i] = beyond | (contradictory if start - end > slack else _NOTHING)
        low[i] = min(start, end)
        high[i] = max(start, end)


# Largest mean square radius of a code's pixels, in pixels²: this plus the median number of pixels per cell (a compact
# patch has a sixth of its number, a stripe of four times its width a third).
_SMALLEST_SPREAD = 1.0
# A cell with many fewer pixels than the fullest around it is cut off, and its pixels' mean is not its centre. The side
# of a whole cell varies by a pixel, from sampling, and by this share of it, from perspective and shading; cells of
# fewer than `_COUNTABLE` pixels are not tested.
_VARYING_PX, _VARYING = 1.0, 0.13
_COUNTABLE = 6


@dataclass(frozen=True)
class CellMatches:
    """M matches of cells with each other's centres."""

    camera_px: Floats
    """(M, 2)"""
    projector_px: Floats
    """(M, 2)"""
    variance: Floats
    """(M,): of each projector coordinate."""
    rejected: Bools
    """(H, W): pixels of cut-off cells, or of a code that also occurs elsewhere, so that one occurrence is wrong."""


def average_cells(
    kept: Bools, cell_px: Floats32, projector_px: Floats32, variance: Floats32, brightness: Image
) -> CellMatches:
    """Average the `kept` pixels (H, W) whose cells have the same centre `cell_px` (H, W, 2), weighted by `brightness`.

    `projector_px` (H, W, 2): their coordinates, which differ from the centre by a motion that was taken back. Cells are
    told apart by half a pixel.
    """
    rejected = np.zeros(kept.shape, np.bool_)
    if not kept.any():
        return CellMatches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), rejected)
    half_px, pixels = np.empty((2, np.count_nonzero(kept), 2), np.int32)
    _list_pixels(kept, cell_px, half_px, pixels)
    (across, number_x), (down, number_y) = (_numbered(half_px[:, axis]) for axis in (0, 1))
    group = number_y[half_px[:, 1]] * np.int32(len(across)) + number_x[half_px[:, 0]]
    counts = np.bincount(group, minlength=len(across) * len(down))
    cells = np.flatnonzero(counts)
    cell_y, cell_x = np.divmod(cells, len(across))
    number = np.empty(len(counts), np.int32)
    number[cells] = np.arange(len(cells), dtype=np.int32)
    group, count = number[group], counts[cells]

    weight, of_variance, square = np.zeros((3, len(cells)))
    camera_px, shift_px, middle_px = np.zeros((3, len(cells), 2))
    of_pixels = pixels, group, brightness.astype(np.float32), variance, half_px, projector_px
    _add_up(*of_pixels, weight, camera_px, shift_px, middle_px, square, of_variance)
    camera_px /= weight[:, None]
    shift_px /= weight[:, None]
    middle_px /= count[:, None]
    spread = square / count + np.sum((camera_px - middle_px) ** 2 - middle_px**2, axis=1)
    good = spread <= _SMALLEST_SPREAD + np.median(count)
    good &= _is_whole(cell_x, cell_y, count)
    rejected[kept] = ~good[group]
    centre_px = np.stack([across[cell_x], down[cell_y]], axis=1) + shift_px
    return CellMatches(camera_px[good], centre_px[good], (of_variance / count**2)[good], rejected)


def _numbered(half_px: Ints) -> tuple[Floats, Ints]:
    """Return the distinct cell centres, ascending, and a table of their indices by half-pixel coordinate.

    `half_px` (N,). Like numpy.unique, without sorting millions of numbers.
    """
    there = np.bincount(half_px) > 0
    number: Ints = np.cumsum(there, dtype=np.int32) - np.int32(1)
    return (np.flatnonzero(there) - 1) / 2.0, number


@compiled
def _list_pixels(kept: Bools, cell_px: Floats32, half_px: Ints, pixels: Ints) -> None:
    """List the kept pixels, (N, 2) each: centres of cells in half pixels, counted from −0.5; camera column and row."""
    height, width = kept.shape
    n = 0
    for row in range(height):
        for column in range(width):
            if kept[row, column]:
                for axis in range(2):
                    half_px[n, axis] = int(2 * cell_px[row, column, axis] + 1.5)
                pixels[n, 0], pixels[n, 1] = column, row
                n += 1


@compiled
def _add_up(
    pixels: Ints,
    group: Ints,
    brightness: Floats32,
    variance: Floats32,
    half_px: Ints,
    projector_px: Floats32,
    weight: Floats,
    camera_px: Floats,
    shift_px: Floats,
    middle_px: Floats,
    square: Floats,
    of_variance: Floats,
) -> None:
    """Sum weights, weighted pixels and shifts, pixels, their squares and variances by group."""
    for n in range(len(group)):
        (column, row), into = pixels[n], group[n]
        by = brightness[row, column] + 1.0
        weight[into] += by
        camera_px[into, 0] += by * column
        camera_px[into, 1] += by * row
        for axis in range(2):
            shift_px[into, axis] += by * (projector_px[row, column, axis] - (half_px[n, axis] - 1) / 2)
        middle_px[into, 0] += column
        middle_px[into, 1] += row
        square[into] += column * column + row * row
        of_variance[into] += variance[row, column]


def _is_whole(cell_x: Ints, cell_y: Ints, count: Ints) -> Bools:
    if np.median(count) < _COUNTABLE:
        return np.ones(len(count), np.bool_)
    grid = np.zeros((int(cell_y.max()) + 1, int(cell_x.max()) + 1), np.float32)
    grid[cell_y, cell_x] = count
    fullest = cv2.dilate(grid, np.ones((3, 3), np.uint8))
    side, largest = np.sqrt(count), np.sqrt(fullest[cell_y, cell_x])
    whole: Bools = side >= largest - np.maximum(_VARYING_PX, _VARYING * largest)
    return whole
