"""Homographies from which a fit to beating contrasts may start: leans are tried, the rest is the peak of a spectrum."""

from collections.abc import Iterator

import numpy as np
from scipy import fft

from calib.numerics import Floats, in_parallel
from scanner.reconstruction.keystone.beat import UPRIGHT, Beat

# How much narrower the far edge may be, for which is looked; more of it leaves no fine stripes.
_MOST_NARROWER = 0.05
_STEP_PX = 0.4  # at the picture's corners
_CELLS_ALONG = 213
_LEAST_CELL_PX = 4.0
_PADDED = 1.5
_TRIED, _APART_PX = 8, 0.4
# What no beat explains of a spectrum, relative to noise, stays below it.
_LEAST_POWER = 50.0


def starts(beat: Beat) -> Iterator[tuple[tuple[int, ...], Floats]]:
    """Homographies that are nearly right, the likeliest first, each with those of its numbers that are not zero. None
    where nothing beats.

    A lean multiplies waves by a chirp; without that each axis has one frequency left, which a Fourier transform finds.
    """
    width, height = beat.size
    cell = max(_LEAST_CELL_PX, width / _CELLS_ALONG)
    columns, rows = int(width / cell) + 2, int(height / cell) + 2
    column = ((beat.x * beat.half + width / 2) / cell).astype(np.int64).clip(0, columns - 1)
    row = ((beat.y * beat.half + height / 2) / cell).astype(np.int64).clip(0, rows - 1)
    sums = np.bincount(row * columns + column, beat.data, minlength=rows * columns).reshape(rows, columns)
    at_x = (((np.arange(columns) + 0.5) * cell - width / 2) / beat.half)[None, :]
    at_y = (((np.arange(rows) + 0.5) * cell - height / 2) / beat.half)[:, None]
    padded = fft.next_fast_len(int(_PADDED * rows)), fft.next_fast_len(int(_PADDED * columns))
    frequencies = [fft.fftfreq(size, cell / beat.half) for size in padded]
    first = np.array([at_y[0, 0], at_x[0, 0]])

    def peak(chirp: Floats) -> tuple[float, float, float, float]:
        turned = (sums * np.exp(2j * np.pi * beat.half * chirp)).astype(np.complex64)
        spectrum = fft.fft2(turned, s=padded)
        power = np.abs(spectrum)
        at = np.unravel_index(int(np.argmax(power)), padded)
        by_y, by_x = (float(of[i]) for of, i in zip(frequencies, at, strict=True))
        cycles = float(np.angle(spectrum[at])) / (2 * np.pi) - by_y * first[0] - by_x * first[1]
        return float(power[at]) ** 2, by_x, by_y, cycles

    found = []
    for lean_at, (of_x, of_y), furthest in (
        (7, (at_x * at_y, at_y * at_y), height / width),
        (6, (at_x * at_x, at_x * at_y), 1.0),
    ):
        step = _STEP_PX / (beat.half * furthest)
        for number in range(int(np.ceil(_MOST_NARROWER / (2 * furthest * step))) + 1):
            lean = number * step
            (power_x, xx, _, x1), (power_y, _, yy, y1) = in_parallel(peak, [lean * of_x, lean * of_y])
            # Beats along y lower the ratio.
            cycles = [each - round(each) for each in (x1, y1 + 0.5)]
            values = np.array([xx, 0.0, cycles[0], 0.0, yy, cycles[1], 0.0, 0.0]) / beat.half
            values[lean_at] = lean
            found.append((power_x + power_y, lean_at, values))
    found.sort(key=lambda each: -each[0])
    tried: list[Floats] = []
    if found[0][0] < _LEAST_POWER * float(np.sum(beat.data**2)):
        return
    for _, lean_at, values in found:
        there = _at_corners(values, height / width)
        if all(np.abs(there - other).max() * beat.half > _APART_PX for other in tried):
            tried.append(there)
            yield (*UPRIGHT, lean_at), values if _shrinks(there, height / width) else -values
        if len(tried) == _TRIED:
            return


def _corners(tall: float) -> Floats:
    """Of a picture that is so tall as a part of its width, (4, 2)."""
    return np.array([(x, y) for x in (-1, 1) for y in (-tall, tall)])


def _at_corners(values: Floats, tall: float) -> Floats:
    """By how much the corners of the picture move, (4, 2)."""
    corners = _corners(tall)
    there = corners * (1 + values[[0, 4]]) + values[[2, 5]]
    moved: Floats = there / (1 + corners @ values[6:])[:, None] - corners
    return moved


def _shrinks(moved: Floats, tall: float) -> bool:
    """Whether the corners of the picture move inwards, on the whole."""
    return float(np.sum(moved * _corners(tall))) < 0
