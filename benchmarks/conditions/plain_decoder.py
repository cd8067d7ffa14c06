"""A plain decoder of Gray codes and fringes, without checks and corrections.

It shows whether the refusal of a capture was necessary. It shares only the definition of the patterns with the
program's decoder.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.geometry import Calibration, Matches, cross_epipolar_lines
from calib.numerics import Floats, Image
from scanner.patterns import Black, Gray, Pattern, Phase, White, Xor

_LIT = 0.1  # of the brightest contrast between white and black


def plain_matches(
    patterns: Sequence[Pattern],
    frames: Sequence[Image],
    *,
    without_bits: int = 0,
    calibration: Calibration | None = None,
) -> Matches:
    """Frames (H, W) → a match per lit pixel, or per cell without fringes; the finest bits may be left out.

    The other coordinate of patterns along one axis comes from the `calibration`.
    """
    images = {pattern: frame.astype(np.float32) for pattern, frame in zip(patterns, frames, strict=True)}
    white = images.get(White(), np.max([*images.values()], axis=0))
    black = images.get(Black(), np.min([*images.values()], axis=0))
    contrast = white - black
    lit = contrast > _LIT * np.percentile(contrast, 99)
    middle = (white + black)[lit] / 2
    shown = {pattern: image[lit] for pattern, image in images.items()}
    camera_px = np.argwhere(lit)[:, ::-1].astype(np.float64)
    axes = sorted({pattern.axis for pattern in patterns if isinstance(pattern, Gray | Xor | Phase)})
    coordinates = np.stack([_coordinate(axis, shown, middle, without_bits) for axis in axes], axis=1)
    if len(axes) == 1 and calibration is not None:
        measured = 0 if axes == ["x"] else 1
        coordinates = cross_epipolar_lines(camera_px, coordinates[:, 0], measured, calibration).projector_px
        return Matches(camera_px, coordinates)
    if any(isinstance(pattern, Phase) for pattern in patterns):
        return Matches(camera_px, coordinates)
    return _averaged(camera_px, coordinates)


def _coordinate(axis: str, shown: dict[Pattern, Floats], middle: Floats, without_bits: int) -> Floats:
    """The projector's coordinate of pixels (n,) along an axis."""
    coordinate = _of_code(axis, shown, middle, without_bits)
    for period in sorted({p.period for p in shown if isinstance(p, Phase) and p.axis == axis}, reverse=True):
        steps = [p for p in shown if isinstance(p, Phase) and p.axis == axis and p.period == period]
        cycles = _cycles(np.array([p.shift for p in steps]), np.stack([shown[p] for p in steps]))
        whole = -np.floor(cycles) if coordinate is None else np.rint(coordinate / period - cycles)
        coordinate = period * (cycles + whole)
    if coordinate is None:
        raise ValueError(f"nothing varies along {axis}")
    return coordinate


def _of_code(axis: str, shown: dict[Pattern, Floats], middle: Floats, without_bits: int) -> Floats | None:
    """Coordinate from the bits of an axis; those of an XOR code are relative to a plain one. None without any."""
    bits = [p for p in shown if isinstance(p, Gray | Xor) and p.axis == axis and not p.inverted]
    if not bits:
        return None
    bright = {p.bit: shown[p] > shown.get(replace(p, inverted=True), middle) for p in bits if isinstance(p, Gray)}
    for p in bits:
        if isinstance(p, Xor):
            relative = shown[p] > shown.get(replace(p, inverted=True), middle)
            bright[p.bit] = relative ^ bright[p.base]
    word, number = np.zeros(middle.shape, np.int64), np.zeros(middle.shape, np.int64)
    for bit in sorted(bright)[: len(bright) - without_bits]:
        word = bright[bit] ^ (word & 1)
        number = 2 * number + word
    cell = bits[0].cell * 2**without_bits
    coordinate: Floats = number * float(cell) + (cell - 1) / 2 - bits[0].offset
    return coordinate


def _cycles(shifts: Floats, levels: Floats) -> Floats:
    """Position of pixels in the cycle of the fringe, (n,), by least squares over the steps (k,) of `levels` (k, n)."""
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
