"""Samples: evenly spread or at random, for estimates and checks that need no more; and what is distinct of many."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics.arrays import Bools, Ints
from calib.numerics.jit import compiled

# Elements of a sample: their median has a standard error of 1.25 / √n, a fiftieth of their standard deviation.
ENOUGH_PIXELS = 4096
# The same where hundreds of trials are made: a sixteenth of it.
TRIAL_PIXELS = 400
# For an effect smaller than the scatter that the whole picture shows: a two hundredth of it.
MANY_PIXELS = 65536
SEED = 20_240_229  # of random choices, which must be the same in every run
# Multiples of it, modulo one, fill the interval evenly.
_GOLDEN_RATIO = 0.6180339887498949
# Lines of an image, along which neighbours are compared: they cross thousands of edges between a code's cells.
_LINES = 128


def evenly(chosen: Bools, size: int) -> Ints:
    """Indices of elements of a mask (N,) that are set: all, or one of every few, `size` to twice as many.

    The distances vary, because equal ones would alias with the rows of an image.
    """
    count = int(np.count_nonzero(chosen))
    step = max(1, count // size)
    indices = np.empty(-(-count // step), np.int64)
    _every(step, count, np.ascontiguousarray(chosen), indices)
    return indices


@compiled
def _every(step: int, count: int, chosen: Bools, indices: Ints) -> None:
    """One of every `step` elements that are set, of which there are `count`."""
    number = wanted = drawn = 0
    for i in range(len(chosen)):
        if chosen[i]:
            if number == wanted:
                indices[drawn] = i
                drawn += 1
                wanted = drawn * step + int(drawn * _GOLDEN_RATIO % 1.0 * min(step, count - drawn * step))
            number += 1


def evenly_spread(values: NDArray[Any], most: int = ENOUGH_PIXELS, axis: int = 0) -> NDArray[Any]:
    """Return every k-th of the values (N, …), or (…, N) along the last `axis`, as many as possible up to `most`."""
    step = max(1, -(-values.shape[axis] // most))
    return values[::step] if axis == 0 else np.ascontiguousarray(values[..., ::step])


def lines_of(image: NDArray[Any]) -> NDArray[Any]:
    """Return some rows, evenly spread over an image (H, W), contiguous in memory."""
    return np.ascontiguousarray(evenly_spread(image, _LINES))


def at_random(count: int, most: int = ENOUGH_PIXELS) -> Ints:
    """Return at most so many of the numbers below `count`, in ascending order; they cannot beat with a pattern."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(SEED).choice(count, most, replace=False))


def chosen_ones(chosen: Bools, numbers: Ints) -> Ints:
    """Return the flat indices of some of the chosen pixels (H, W), by ascending `numbers` (N,), counted row by row.

    A list of all of them takes eight times the memory of the image.
    """
    indices = np.empty(len(numbers), np.int64)
    _note_ones(np.ascontiguousarray(chosen), numbers, indices)
    return indices


@compiled
def _note_ones(chosen: Bools, numbers: Ints, indices: Ints) -> None:
    """Fill in the flat indices (N,) of the set elements (H, W) with these numbers."""
    height, width = chosen.shape
    before = drawn = 0
    for row in range(height):
        of_row = chosen[row]
        count = 0
        for column in range(width):
            count += of_row[column]
        number = before
        if drawn < len(numbers) and numbers[drawn] < before + count:
            for column in range(width):
                if of_row[column]:
                    if drawn < len(numbers) and number == numbers[drawn]:
                        indices[drawn] = row * width + column
                        drawn += 1
                    number += 1
        before += count


def distinct(count: int, alike: Callable[[int], Bools], most: int | None = None) -> list[int]:
    """Return which of `count` candidates, best first, are like none of the better ones that are returned.

    `alike`: which candidates (count,) are like the one of this number. `most`: how many are returned at most.
    """
    remaining, chosen = np.ones(count, np.bool_), list[int]()
    while remaining.any() and (most is None or len(chosen) < most):
        best = int(np.argmax(remaining))
        chosen.append(best)
        remaining &= ~alike(best)
        remaining[best] = False
    return chosen
