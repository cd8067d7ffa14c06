"""Decide the bits that something moving has corrupted, by the surface around them.

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

from calib.numerics import Bools, Floats32, Image, Words, median
from scanner.decoding.codes import CodeWords, cell_numbers
from scanner.decoding.significance import FEW, FEWEST_PIXELS, HALF

# Cells are compared over this many pixels to either side, and their growth is averaged over a window of this side.
_REACH_PX, _WINDOW_PX = 2, 5
# Side of the window of a plane, and how often it is fitted: decided pixels spread by half a window each time.
_PLANE_PX, _ROUNDS = 9, 8
# Largest distance of a cell from the plane of its neighbours: half a cell for each of them, and as much for a bend.
_NEAR_CELLS = 1.5
_MOST_CORRUPTED = 2  # bits of a pixel: one that is hidden longer stays corrupted


def repair_bits(
    code_words: CodeWords, corrupted: Mapping[int, Bools], frames: Mapping[int, Image], static: Bools
) -> Bools:
    """Decide corrupted bits of a plain Gray code, in place; return the pixels (H, W) at which all of them are decided.

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
        return decided
    decided[part], words[part] = decision
    least = np.full_like(code_words.least, np.iinfo(code_words.least.dtype).max)
    for bit, (normal, inverse) in code_words.code.pairs.items():
        where = corrupted.get(bit, np.zeros_like(decided))
        # A corrupted frame gives no edge to interpolate from.
        bit_image = (words >> (code_words.code.bits - 1 - bit) & 1).astype(np.uint8)
        decided &= ~(where & (cv2.morphologyEx(bit_image, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0))
        contrast = cv2.absdiff(frames[normal], frames[inverse]).astype(least.dtype)
        np.minimum(least, contrast, out=least, where=~where)
    code_words.decide(decided, words, least)
    return decided


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
