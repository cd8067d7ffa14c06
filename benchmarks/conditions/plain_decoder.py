"""A page of plain code that decodes Gray codes and fringes, with no checks and no corrections.

What it decodes well could be decoded: it says of a refused capture whether the refusal was needed. It shares nothing
with the program's decoder but the definition of the patterns.
"""

from collections.abc import Sequence

import numpy as np

from calib.geometry import Matches
from calib.numerics import Floats, Image
from scanner.patterns import Black, Gray, Pattern, Phase, White

_LIT = 0.1  # of the brightest contrast between white and black


def plain_matches(patterns: Sequence[Pattern], frames: Sequence[Image], *, without_bits: int = 0) -> Matches:
    """Frames (H, W) → a match per lit pixel; without fringes one per cell, of which the finest bits may be left out."""
    images = {pattern: frame.astype(np.float32) for pattern, frame in zip(patterns, frames, strict=True)}
    white, black = images[White()], images[Black()]
    contrast = white - black
    lit = contrast > _LIT * np.percentile(contrast, 99)
    middle = (white + black)[lit] / 2
    shown = {pattern: image[lit] for pattern, image in images.items()}
    camera_px = np.argwhere(lit)[:, ::-1].astype(np.float64)
    coordinates = np.stack([_coordinate(axis, shown, middle, without_bits) for axis in ("x", "y")], axis=1)
    if any(isinstance(pattern, Phase) for pattern in patterns):
        return Matches(camera_px, coordinates)
    return _averaged(camera_px, coordinates)


def _coordinate(axis: str, shown: dict[Pattern, Floats], middle: Floats, without_bits: int) -> Floats:
    """The projector's coordinate of pixels (n,) along an axis."""
    bits = sorted(
        (p for p in shown if isinstance(p, Gray) and p.axis == axis and not p.inverted), key=lambda gray: gray.bit
    )
    kept = bits[: len(bits) - without_bits]
    word, number = np.zeros(middle.shape, np.int64), np.zeros(middle.shape, np.int64)
    for bit in kept:
        inverse = Gray(bit.axis, bit.bit, bit.bits, bit.cell, bit.offset, inverted=True)
        bright = shown[bit] > shown.get(inverse, middle)
        word = bright ^ (word & 1)
        number = 2 * number + word
    cell = bits[0].cell * 2**without_bits
    coordinate = number * float(cell) + (cell - 1) / 2 - bits[0].offset
    for period in sorted({p.period for p in shown if isinstance(p, Phase) and p.axis == axis}, reverse=True):
        steps = [p for p in shown if isinstance(p, Phase) and p.axis == axis and p.period == period]
        cycles = _cycles(np.array([p.shift for p in steps]), np.stack([shown[p] for p in steps]))
        coordinate = period * (cycles + np.rint(coordinate / period - cycles))
    return coordinate


def _cycles(shifts: Floats, levels: Floats) -> Floats:
    """Where in the fringe's cycle pixels are, (n,), by least squares over the steps (k,) of `levels` (k, n)."""
    angle = 2 * np.pi * shifts
    design = np.stack([np.ones_like(angle), np.cos(angle), -np.sin(angle)], axis=1)
    _, cosine, sine = np.linalg.lstsq(design, levels, rcond=None)[0]
    cycles: Floats = np.arctan2(sine, cosine) / (2 * np.pi)
    return cycles


def _averaged(camera_px: Floats, coordinates: Floats) -> Matches:
    """One match per projector cell: the mean of the camera pixels that see it."""
    cells, member = np.unique(coordinates, axis=0, return_inverse=True)
    count = np.bincount(member)
    means = [np.bincount(member, camera_px[:, axis]) / count for axis in (0, 1)]
    return Matches(np.stack(means, axis=1), cells)
