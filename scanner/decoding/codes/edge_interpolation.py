"""Interpolate the projector coordinate at camera pixels between the stripe edges on either side.

An edge is where pattern and inverse are equally bright (Trobina, Error model of a coded-light range sensor, ETH Zürich,
1995). Symmetric blur and the camera's response curve leave it in place. The difference of the two is interpolated
linearly between two camera pixels; it is divided by their sum, so that a change of albedo between the pixels does not
move the edge. Each edge of a Gray code belongs to one bit, the coarsest in which the pixels differ, and to one
projector coordinate.

Along rows, and along columns, each edge is a sub-pixel camera position of known projector coordinate. Between
successive edges the coordinate is interpolated linearly. The results of the two directions are averaged.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Floats32, Image, Ints, Words, compiled
from scanner.decoding.codes.gray_code import cell_numbers, compared
from scanner.decoding.light import NoiseModel
from scanner.decoding.sequence_plan import GrayCode

# Stripes of two cells are resolved down to one camera pixel each: at most this many cells lie between two pixels, and
# twice as many between edges, if some were not resolved.
CELLS_PER_PIXEL = 2
# Change of slope from one pair of edges to the next, as a share of the slope, where no other pair is known. A slope is
# a jump if it is this many times the neighbouring ones, and steeper by this many sigmas.
BEND_OF_SLOPE = 0.25
_JUMP, _SIGMAS = 1.5, 3.0
# Edges of the same stripe this close together are one edge, split by noise.
_SAME_EDGE_PX, _SHORTEST_PX = 2.0, 0.1
# Standard deviation of an edge's position, in camera pixels, from its shape, which is modelled as Gaussian blur.
_SHAPE_PX = 0.02
# Difference of pattern and inverse in indirect light, as a share of the step from dark to bright; the more blurred an
# edge is, the farther this shifts it.
_STRAY = 0.01
# Above this share of the light, noise dominates the distance of an edge.
_SATURATED = 0.97
# Variance of a pair's difference, and of twice the difference of a frame and its threshold, in units of a pixel's.
_PAIR, _HALF = 2.0, 6.0
# Per edge: position along the line, its variance, number of the code's edge, cells between the pixels on either side,
# slope from the edge before to this one, in cells per camera pixel; 0 if the surface does not continue from there.
_PLACE, _SPREAD, _EDGE, _STEP, _SLOPE = range(5)


@dataclass(frozen=True)
class Lines:
    """L rows, or columns, of N pixels: (L, N) each."""

    words: Words
    """Of the code."""
    usable: Bools
    """Lit, and with a code."""
    least: Floats32
    """Least contrast of a certain edge."""
    threshold: Image
    """As in `Signals`."""
    white: Image
    """As in `Signals`."""
    levels: Image
    """(2, bits, L, N): as returned by `levels_of_bits`."""


def levels_of_bits(
    code: GrayCode, frames: Mapping[int, Image], thresholds: Mapping[int, Image]
) -> tuple[list[Image], list[Image]]:
    """Return, per bit of a code, the bright and the dark image (H, W) that were compared.

    `frames`: by index. `thresholds`: per frame of a bit without an inverse, in place of the other image.
    """
    nothing = next(iter(frames.values()))  # pixels do not differ in a bit that was never shown: any image will do
    images_of = {bit: images for bit, *images in compared(code, frames, thresholds)}
    bright, dark = zip(*(images_of.get(bit, [nothing, nothing]) for bit in range(code.bits)), strict=True)
    return list(bright), list(dark)


def interpolate(code: GrayCode, noise: NoiseModel, lines: Lines, value: Floats32, variance: Floats32) -> None:
    """Average the coordinates interpolated along lines into `value` and `variance` (L, N), in cells from the code's
    first.

    The variance is infinite where nothing is known, and stays so where no edge is found.
    """
    threshold_side = np.array([int(bit in code.normal) if bit in code.unpaired else -1 for bit in range(code.bits)])
    numbers = cell_numbers(lines.words).astype(np.int32)
    _interpolate(
        numbers,
        lines.usable,
        lines.least,
        lines.threshold,
        lines.white,
        value,
        variance,
        lines.levels,
        threshold_side,
        noise.at_black,
        noise.gain,
    )


@compiled
def _interpolate(
    numbers: Ints,
    usable: Bools,
    least: Floats32,
    threshold: Image,
    white: Image,
    value: Floats32,
    variance: Floats32,
    levels: Image,
    threshold_side: Ints,
    at_black: float,
    per_level: float,
) -> None:
    """Average the interpolated coordinates along lines (L, N) into `value`, in cells, and `variance`.

    `numbers`: of the cells. `threshold_side` (bits,): which of a bit's two `levels` (2, bits, L, N) is a threshold; −1
    for none.
    """
    edges = np.empty((_SLOPE + 1, numbers.shape[1]))
    for line in range(len(numbers)):
        of_line = numbers[line], usable[line], least[line], levels[:, :, line], threshold_side
        of_noise = threshold[line], white[line], at_black, per_level
        count = _list_edges(of_line, of_noise, edges)
        for k in range(1, count):
            if edges[_SLOPE, k]:
                curved = _curved(edges, k, count)
                if not np.isnan(curved):
                    _fill(edges, k, curved, numbers[line], value[line], variance[line])


@compiled
def _list_edges(
    of_line: tuple[Ints, Bools, Floats32, Image, Ints],
    of_noise: tuple[Image, Image, float, float],
    edges: Floats,
) -> int:
    """List the edges along a line (N,) in columns of `edges` (rows, N); return their number."""
    numbers, usable, least, levels, threshold_side = of_line
    threshold, white, at_black, per_level = of_noise
    bits, most = len(threshold_side), 2 * CELLS_PER_PIXEL
    count, goes_on = 0, False
    for i in range(len(numbers) - 1):
        if not (usable[i] and usable[i + 1]):
            goes_on = False
            continue
        low, high = min(numbers[i], numbers[i + 1]), max(numbers[i], numbers[i + 1])
        if low == high:
            continue
        size = 0
        while (low ^ high) >> size > 1:
            size += 1
        bit, number = bits - 1 - size, (high >> size) << size
        part, contrast = edge_between(levels[:, bit, i], levels[:, bit, i + 1], threshold_side[bit])
        if contrast < least[i]:
            continue
        if high - low > most:
            goes_on = False
            continue
        level = np.float64(threshold[i])
        sharp = contrast / max(np.float64(white[i]) - level, 1.0)
        place = i + _of_blurred(part, sharp)
        noise = (_PAIR if threshold_side[bit] < 0 else _HALF) * (at_black + per_level * level) / (2.0 * contrast) ** 2
        before = max(count - 1, 0)
        apart = abs(number - edges[_EDGE, before]) if goes_on else 0.0
        if goes_on and apart == 0 and place - edges[_PLACE, before] < _SAME_EDGE_PX:
            edges[_PLACE, before] = 0.5 * (edges[_PLACE, before] + place)
            continue
        edges[_PLACE, count], edges[_EDGE, count], edges[_STEP, count] = place, number, high - low
        edges[_SPREAD, count] = ((1 - part) ** 2 + part**2) * noise + _SHAPE_PX**2 + (_STRAY / sharp) ** 2
        edges[_SLOPE, count] = apart if apart <= most else 0.0
        goes_on = True
        count += 1
    for k in range(count):
        if edges[_SLOPE, k]:
            edges[_SLOPE, k] /= max(edges[_PLACE, k] - edges[_PLACE, k - 1], _SHORTEST_PX)
    return count


@compiled
def edge_between(here: Image, there: Image, threshold_side: int) -> tuple[float, float]:
    """Return where between two pixels their bright and dark levels (2,) cross, from 0 to 1, and the mean contrast, in
    whole grey levels.

    `threshold_side`: which of the two levels is half-way between lit and unlit; −1 if neither is. Twice it then
    replaces their sum, and the difference is half.
    """
    first, second = (1, 1) if threshold_side == 1 else (0, 0 if threshold_side == 0 else 1)
    difference, difference_there = abs(float(here[0]) - here[1]), abs(float(there[0]) - there[1])
    near = difference * (float(there[first]) + there[second])
    far = difference_there * (float(here[first]) + here[second])
    contrast = np.floor((difference + difference_there) * (0.5 if threshold_side < 0 else 1.0) + 0.5)
    return near / max(near + far, 1e-6), float(contrast)


@compiled
def _of_blurred(part: float, sharp: float) -> float:
    """Return the sub-pixel position of an edge blurred by a Gaussian, between two pixels.

    `part`: its position by linear interpolation, from the first pixel. `sharp`: the difference of the two pixels,
    relative to half the step from dark to bright.
    """
    here, there = _inverse_error_function(part * sharp), _inverse_error_function((1.0 - part) * sharp)
    return float(here / max(here + there, 1e-9))


@compiled
def _inverse_error_function(value: float) -> float:
    """Return erf⁻¹ of 0 to 1, to 0.2 % (Winitzki, A handy approximation for the error function and
    its inverse, 2008).
    """
    logarithm = np.log(1.0 - min(value, _SATURATED) ** 2)
    half = 2.0 / (np.pi * 0.147) + 0.5 * logarithm
    return float(np.sqrt(max(np.sqrt(half * half - logarithm / 0.147) - half, 0.0)))


@compiled
def _curved(edges: Floats, k: int, count: int) -> float:
    """Return how far the surface between an edge and the one before may be from a straight line, in cells.

    From the neighbouring slopes; NaN if there is a jump.
    """
    length = max(edges[_PLACE, k] - edges[_PLACE, k - 1], _SHORTEST_PX)
    slope, before, after = edges[_SLOPE, k], edges[_SLOPE, k - 1], edges[_SLOPE, k + 1] if k + 1 < count else 0.0
    steps = max(edges[_STEP, k], edges[_STEP, k - 1])
    if before == 0 and after == 0:
        return BEND_OF_SLOPE * slope * length / 8 if steps == 1 else np.nan
    by_noise = _SIGMAS * slope * np.sqrt(edges[_SPREAD, k] + edges[_SPREAD, k - 1]) / length
    steepest = _JUMP * max(before, after) + by_noise
    if slope > steepest or steps > 1 + steepest:
        return np.nan
    bend = max(0.0 if before == 0 else abs(slope - before), 0.0 if after == 0 else abs(slope - after))
    # For a slope that changes by this much between the middles of successive pieces.
    return float(bend * length / 8)


@compiled
def _fill(edges: Floats, k: int, curved: float, numbers: Ints, value: Floats32, variance: Floats32) -> None:
    """Average in the interpolated coordinates between an edge and the one before, if within a cell of each pixel's own
    cell.
    """
    start, first, cells = edges[_PLACE, k - 1], edges[_EDGE, k - 1], edges[_EDGE, k] - edges[_EDGE, k - 1]
    length = max(edges[_PLACE, k] - start, _SHORTEST_PX)
    slope = cells / length
    for i in range(int(np.ceil(start)), int(np.floor(edges[_PLACE, k])) + 1):
        share = (i - start) / length
        coordinate = first + share * cells
        if abs(coordinate - numbers[i] - 0.5) > 1.5:
            continue
        noise = (1 - share) ** 2 * edges[_SPREAD, k - 1] + share * share * edges[_SPREAD, k]
        own = slope * slope * noise + curved * curved
        if np.isinf(variance[i]):
            value[i], variance[i] = coordinate, own
        else:
            part = variance[i] / (variance[i] + own)
            value[i] += part * (coordinate - value[i])
            variance[i] *= 1.0 - part
