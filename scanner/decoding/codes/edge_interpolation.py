"""Interpolate the projector coordinate at camera pixels between the stripe edges on either side.

An edge is where pattern and inverse are equally bright (Trobina, Error model of a coded-light range sensor, ETH Zürich,
1995). Symmetric blur and the camera's response curve leave it in place. The difference of the two is interpolated
linearly between two camera pixels; it is divided by their sum, so that a change of albedo between the pixels does not
move the edge. Each edge of a Gray code belongs to one bit, the coarsest in which the pixels differ, and to one
projector coordinate.

Along rows, and along columns, each edge is a sub-pixel camera position of known projector coordinate. Between
successive edges the coordinate is interpolated linearly. The results of the two directions are averaged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from calib.numerics import Bools, Floats, Floats32, Image, Ints, Words, compiled, in_slices
from scanner.decoding.codes.gray_code import cell_numbers
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
# slope from the edge before to this one, in cells per camera pixel, and how far the surface between the two may be from
# a straight line, in cells squared. A slope of 0: the surface does not continue from there.
_PLACE, _SPREAD, _EDGE, _STEP, _SLOPE, _CURVED, _FIELDS = range(7)
# Rows are followed one by one, columns side by side, as many as share a cache line; this many in a thread's turn.
_BESIDE, _LINES = 32, 128


@dataclass(frozen=True)
class StripeLevels:
    """The grey levels that decide the bits of a code, in the part of the image where edges are looked for."""

    frames: Image
    """(N, H, W): contiguous; the part begins at the pixel `corner` of them."""
    thresholds: Image
    """(K, h, w): grey levels half-way between lit and unlit, for bits without an inverse."""
    sides: Ints
    """(2, bits): per bit, the bright image and the dark one that were compared: a frame's place, or −1 − that of a
    threshold."""
    corner: tuple[int, int]
    """(row, column)."""

    @classmethod
    def of(
        cls,
        code: GrayCode,
        frames: Image,
        places: Mapping[int, int],
        corner: tuple[int, int],
        thresholds: Mapping[int, Image],
    ) -> "StripeLevels":
        """Return the levels of a code.

        `places`: of a frame's index in `frames`. `thresholds` (h, w): per frame of a bit without an inverse, in place
        of the other image.
        """
        alone = [*code.unpaired.values()]
        sides = np.zeros((2, code.bits), np.int64)  # pixels do not differ in a bit that was never shown
        for side, bit_frames, opposite in ((0, code.normal, code.inverse), (1, code.inverse, code.normal)):
            for bit, frame in bit_frames.items():
                sides[side, bit] = places[frame]
                if bit not in opposite:
                    sides[1 - side, bit] = -1 - alone.index(frame)
        images = [thresholds[frame] for frame in alone] or [np.empty((0, 0), frames.dtype)]
        return cls(frames, cast(Image, np.stack(images)), sides, corner)


def interpolate(
    words: Words,
    usable: Bools,
    light: tuple[Image, Image],
    levels: StripeLevels,
    least: Floats32,
    noise: Floats,
    coordinates: Sequence[Floats32],
) -> None:
    """Write the coordinates (H, W) between the edges of a code along rows and columns, in cells from its first, and
    their variance; NaN and infinite where unknown.

    `words` (H, W): of the code. `usable`: pixels that are lit, with a code. `light`: the levels half-way between lit
    and unlit, and when lit. `least` (levels,): least contrast of a certain edge, and `noise` (levels,) variance of a
    pixel, at each grey level.
    """
    height, width = words.shape
    value, variance = coordinates
    numbers = np.empty((height, width), np.uint32 if words.itemsize > np.uint16().itemsize else np.uint16)

    def prepare(rows: slice) -> None:
        numbers[rows], value[rows], variance[rows] = cell_numbers(words[rows]), np.nan, np.inf

    in_slices(height, _LINES, prepare)
    for downwards in (False, True):

        def follow(lines: slice, downwards: bool = downwards) -> None:
            of_bits = levels.frames, levels.thresholds, levels.sides, levels.corner
            where = lines.start, lines.stop, downwards
            _interpolate(numbers, usable, *light, of_bits, least, noise, where, value, variance)

        in_slices(width if downwards else height, _LINES, follow)


@compiled
def _interpolate(
    numbers: Words,
    usable: Bools,
    threshold: Image,
    white: Image,
    of_bits: tuple[Image, Image, Ints, tuple[int, int]],
    least: Floats32,
    noise: Floats,
    where: tuple[int, int, bool],
    value: Floats32,
    variance: Floats32,
) -> None:
    """Average the coordinates interpolated along lines into `value` (H, W), in cells, and `variance`.

    `where`: the first line, the one after the last, and whether lines are columns.
    """
    height, width = numbers.shape
    first, last, downwards = where
    at_once = _BESIDE if downwards else 1
    edges = np.empty((at_once, height if downwards else width, _FIELDS))
    counts, goes_on, segment = np.empty(at_once, np.int64), np.empty(at_once, np.bool_), np.empty(at_once, np.int64)
    for start in range(first, last, at_once):
        stop = min(start + at_once, last)
        window = (0, height, start, stop) if downwards else (start, stop, 0, width)
        counts[:], goes_on[:], segment[:] = 0, False, 1
        of_light = threshold, white, least, noise
        _list_edges(numbers, usable, of_light, of_bits, window, downwards, edges, counts, goes_on)
        for line in range(stop - start):
            _note_slopes(edges, line, counts[line])
        _fill(numbers, edges, counts, window, downwards, segment, value, variance)


@compiled
def _list_edges(
    numbers: Words,
    usable: Bools,
    of_light: tuple[Image, Image, Floats32, Floats],
    of_bits: tuple[Image, Image, Ints, tuple[int, int]],
    window: tuple[int, int, int, int],
    downwards: bool,
    edges: Floats,
    counts: Ints,
    goes_on: Bools,
) -> None:
    """List the edges along the lines of a window (top, bottom, left, right) in `edges` (lines, N, fields), and their
    number by line.
    """
    threshold, white, least, noise = of_light
    frames, thresholds, sides, (frame_row, frame_column) = of_bits
    top, bottom, left, right = window
    bits, most = sides.shape[1], 2 * CELLS_PER_PIXEL
    down, across = (1, 0) if downwards else (0, 1)
    for row in range(top, bottom - down):
        for column in range(left, right - across):
            line, i = (column - left, row) if downwards else (row - top, column)
            if not (usable[row, column] and usable[row + down, column + across]):
                goes_on[line] = False
                continue
            here, there = np.int64(numbers[row, column]), np.int64(numbers[row + down, column + across])
            if here == there:
                continue
            low, high = min(here, there), max(here, there)
            size = 0
            while (low ^ high) >> size > 1:
                size += 1
            bit, number = bits - 1 - size, (high >> size) << size
            bright, dark = sides[0, bit], sides[1, bit]
            y, x = row + frame_row, column + frame_column
            if bright >= 0 and dark >= 0:
                near = float(frames[bright, y, x]), float(frames[dark, y, x])
                far = float(frames[bright, y + down, x + across]), float(frames[dark, y + down, x + across])
                threshold_side = -1
            elif bright >= 0:
                near = float(frames[bright, y, x]), float(thresholds[-1 - dark, row, column])
                far = (
                    float(frames[bright, y + down, x + across]),
                    float(thresholds[-1 - dark, row + down, column + across]),
                )
                threshold_side = 1
            else:
                near = float(thresholds[-1 - bright, row, column]), float(frames[dark, y, x])
                far = (
                    float(thresholds[-1 - bright, row + down, column + across]),
                    float(frames[dark, y + down, x + across]),
                )
                threshold_side = 0
            part, contrast = edge_between(near, far, threshold_side)
            level = threshold[row, column]
            if contrast < least[level]:
                continue
            if high - low > most:
                goes_on[line] = False
                continue
            sharp = contrast / max(np.float64(white[row, column]) - np.float64(level), 1.0)
            place = i + _of_blurred(part, sharp)
            own_noise = (_PAIR if threshold_side < 0 else _HALF) * noise[level] / (2.0 * contrast) ** 2
            count = counts[line]
            before = max(count - 1, 0)
            apart = abs(number - edges[line, before, _EDGE]) if goes_on[line] else 0.0
            if goes_on[line] and apart == 0 and place - edges[line, before, _PLACE] < _SAME_EDGE_PX:
                edges[line, before, _PLACE] = 0.5 * (edges[line, before, _PLACE] + place)
                continue
            spread = ((1 - part) ** 2 + part**2) * own_noise + _SHAPE_PX**2 + (_STRAY / sharp) ** 2
            edges[line, count, _PLACE], edges[line, count, _SPREAD] = place, spread
            edges[line, count, _EDGE], edges[line, count, _STEP] = number, high - low
            edges[line, count, _SLOPE] = apart if apart <= most else 0.0
            goes_on[line] = True
            counts[line] = count + 1


@compiled
def _note_slopes(edges: Floats, line: int, count: int) -> None:
    """Divide the steps between the edges of a line by their distance, and note how curved it may be."""
    of_line = edges[line]
    for k in range(count):
        if of_line[k, _SLOPE]:
            of_line[k, _SLOPE] /= max(of_line[k, _PLACE] - of_line[k - 1, _PLACE], _SHORTEST_PX)
    for k in range(1, count):
        of_line[k, _CURVED] = _curved(of_line, k, count) ** 2 if of_line[k, _SLOPE] else np.nan


@compiled
def edge_between(here: tuple[float, float], there: tuple[float, float], threshold_side: int) -> tuple[float, float]:
    """Return where between two pixels their bright and dark levels cross, from 0 to 1, and the mean contrast, in
    whole grey levels.

    `threshold_side`: which of the two levels is half-way between lit and unlit; −1 if neither is. Twice it then
    replaces their sum, and the difference is half.
    """
    difference, difference_there = abs(here[0] - here[1]), abs(there[0] - there[1])
    if threshold_side < 0:
        near, far = difference * (there[0] + there[1]), difference_there * (here[0] + here[1])
    elif threshold_side == 1:
        near, far = difference * (there[1] + there[1]), difference_there * (here[1] + here[1])
    else:
        near, far = difference * (there[0] + there[0]), difference_there * (here[0] + here[0])
    contrast = np.floor((difference + difference_there) * (0.5 if threshold_side < 0 else 1.0) + 0.5)
    return near / max(near + far, 1e-6), float(contrast)


def _inverse_error_function() -> Floats:
    """Return erf⁻¹ of 0 to `_SATURATED`, to 0.2 % (Winitzki, A handy approximation for the error function and its
    inverse, 2008), and its derivative, (N, 2): both times the step of the table.
    """
    values = np.linspace(0, _SATURATED, _ENTRIES)[1:]
    scale, logarithm = 2.0 / (np.pi * 0.147), np.log(1.0 - values**2)
    half, slope = scale + 0.5 * logarithm, -2.0 * values / (1.0 - values**2)
    root = np.sqrt(half**2 - logarithm / 0.147)
    inverse = np.sqrt(root - half)
    derivative = ((0.5 * half * slope - 0.5 * slope / 0.147) / root - 0.5 * slope) / (2.0 * inverse)
    step = _SATURATED / (_ENTRIES - 1)
    return np.stack([np.append(0.0, inverse), step * np.append(np.sqrt(np.pi) / 2, derivative)], axis=1)


_ENTRIES = 1024  # cubic interpolation between so many errs by 3e-9 at most
_INVERSE = _inverse_error_function()
_PER_ENTRY = (_ENTRIES - 1) / _SATURATED


@compiled
def _of_blurred(part: float, sharp: float) -> float:
    """Return the sub-pixel position of an edge blurred by a Gaussian, between two pixels.

    `part`: its position by linear interpolation, from the first pixel. `sharp`: the difference of the two pixels,
    relative to half the step from dark to bright.
    """
    here, there = _distance(part * sharp), _distance((1.0 - part) * sharp)
    return float(here / max(here + there, 1e-9))


@compiled
def _distance(share: float) -> float:
    """Return how far from an edge a share of 0 to 1 of half its step is reached, in √2 of its blur."""
    at = min(max(share, 0.0), _SATURATED) * _PER_ENTRY
    entry = min(int(at), _ENTRIES - 2)
    t = at - entry
    first, second = _INVERSE[entry, 0], _INVERSE[entry + 1, 0]
    rise, slope, slope_after = second - first, _INVERSE[entry, 1], _INVERSE[entry + 1, 1]
    return float(first + t * (slope + t * (3 * rise - 2 * slope - slope_after + t * (slope + slope_after - 2 * rise))))


@compiled
def _curved(edges: Floats, k: int, count: int) -> float:
    """Return how far the surface between an edge and the one before may be from a straight line, in cells.

    From the neighbouring slopes; NaN if there is a jump.
    """
    length = max(edges[k, _PLACE] - edges[k - 1, _PLACE], _SHORTEST_PX)
    slope, before, after = edges[k, _SLOPE], edges[k - 1, _SLOPE], edges[k + 1, _SLOPE] if k + 1 < count else 0.0
    steps = max(edges[k, _STEP], edges[k - 1, _STEP])
    if before == 0 and after == 0:
        return BEND_OF_SLOPE * slope * length / 8 if steps == 1 else np.nan
    steepest = _JUMP * max(before, after)
    if slope > steepest or steps > 1 + steepest:
        steepest += _SIGMAS * slope * np.sqrt(edges[k, _SPREAD] + edges[k - 1, _SPREAD]) / length
        if slope > steepest or steps > 1 + steepest:
            return np.nan
    bend = max(0.0 if before == 0 else abs(slope - before), 0.0 if after == 0 else abs(slope - after))
    # For a slope that changes by this much between the middles of successive pieces.
    return float(bend * length / 8)


@compiled
def _fill(
    numbers: Words,
    edges: Floats,
    counts: Ints,
    window: tuple[int, int, int, int],
    downwards: bool,
    segment: Ints,
    value: Floats32,
    variance: Floats32,
) -> None:
    """Average in the coordinates interpolated between successive edges, if within a cell of each pixel's own cell.

    `segment` (lines,): number of the edge that the next pixel of a line lies before, at first 1.
    """
    top, bottom, left, right = window
    for row in range(top, bottom):
        for column in range(left, right):
            line, i = (column - left, row) if downwards else (row - top, column)
            k, count = segment[line], counts[line]
            while k < count and edges[line, k, _PLACE] < i:
                k += 1
            segment[line] = k
            while k < count and edges[line, k - 1, _PLACE] <= i:
                slope, curved = edges[line, k, _SLOPE], edges[line, k, _CURVED]
                if not np.isnan(curved):
                    start, first = edges[line, k - 1, _PLACE], edges[line, k - 1, _EDGE]
                    share = (i - start) / max(edges[line, k, _PLACE] - start, _SHORTEST_PX)
                    coordinate = first + share * (edges[line, k, _EDGE] - first)
                    if not abs(coordinate - np.int64(numbers[row, column]) - 0.5) > 1.5:
                        noise = (1 - share) ** 2 * edges[line, k - 1, _SPREAD] + share * share * edges[line, k, _SPREAD]
                        own, before = slope * slope * noise + curved, variance[row, column]
                        if np.isinf(before):
                            value[row, column], variance[row, column] = coordinate, own
                        else:
                            part = before / (before + own)
                            value[row, column] += part * (coordinate - value[row, column])
                            variance[row, column] *= 1.0 - part
                k += 1
