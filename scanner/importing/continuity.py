"""Whether a Gray code along one axis is consistent in an order, without a second axis.

Adjacent cells of the projector are adjacent on a surface. In a wrong order, or with another code, adjacent pixels still
differ in one bit, but their cells are far apart.
"""

from collections.abc import Sequence

import numpy as np

from scanner.importing.coarse_coordinates import Mismatch, coordinates
from scanner.importing.samples import LevelSamples
from scanner.patterns import Axis, Gray, Pattern

# Pixels at the edge of a stripe are undecided; this is the distance of the decided ones on either side.
_MOST_APART_PX = 8
_FEWEST_CHANGES = 30
# Tolerances in cells, or as shares of all cells: errors of the finest bits, and cells skipped by large pixels.
_NEAR_CELLS, _NEAR_SHARE = 4, 1 / 64


def broken_order(lines: LevelSamples, patterns: Sequence[Pattern], axis: Axis) -> str | None:
    """Return what contradicts patterns along one axis, tested on rows or columns across the stripes; None if nothing
    does.

    Fringes alone cannot be tested.
    """
    bits = max((p.bits for p in patterns if isinstance(p, Gray) and p.axis == axis), default=0)
    if not bits:
        return None
    code = coordinates(lines, patterns, axis)
    if isinstance(code, Mismatch):
        return code.words
    if code is None:
        return None
    number, certain = ((part if axis == "x" else part.T) for part in (code.values.astype(np.int64), code.certain))
    place = np.flatnonzero(certain)
    row, column = np.divmod(place, certain.shape[1])
    beside = (np.diff(row) == 0) & (np.diff(column) <= _MOST_APART_PX)
    number = number.ravel()[place]
    word = number ^ number >> 1
    cells, changed = np.abs(np.diff(number))[beside], (word[1:] ^ word[:-1])[beside]
    near = max(_NEAR_CELLS, _NEAR_SHARE * (1 << bits))
    for bit in range(bits):
        of_bit = cells[changed >> bits - 1 - bit & 1 == 1]
        if len(of_bit) >= _FEWEST_CHANGES and np.median(of_bit) > near:
            apart = f"bit {bit} of {axis} are {np.median(of_bit):.0f} cells apart"
            return f"no Gray code in an order that is known: pixels beside each other that differ in {apart}"
    return None
