"""Estimate the smooth fringe shift due to video compression, from the difference of the forward and the backward pass.

Errors of an encoder are independent each time a picture is shown, and ghosting has the opposite sign in reverse order.
So half the difference of the two passes is as large as the error of their mean.
"""

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.numerics import CUBIC, orthonormal_polynomials
from scanner.patterns import Axis, Phase
from scanner.recordings.averaging import Averaged
from scanner.recordings.programme import Programme
from scanner.recordings.weights import PictureWeights

# Errors common to both passes are not seen: true errors were 1 to 1.5 times the measured ones, and more on dark faces.
_UNSEEN = 2.0
_LEAST_SHARE = 0.25  # least share of a picture's weight, in either pass
_LEAST_AMPLITUDE = 0.1  # least amplitude relative to the best lit pixels
_PARTS = 2  # parts of the height and of the width, each about as large as a face
_FEWEST = 30 * CUBIC
_OUTLIER = 5.0  # times the median is an outlier
_WELL_LIT = 98.0


def smooth_px(programme: Programme, weights: Sequence[PictureWeights], averaged: Averaged) -> float | None:
    """Return the `smooth_px` of `calib.refinement.Shifts`, in projector pixels, for the shortest fringes; None without
    fringes.
    """
    fringes = defaultdict[tuple[Axis, float], list[tuple[int, Phase]]](list)
    for number, pattern in enumerate(programme.patterns):
        if isinstance(pattern, Phase):
            fringes[pattern.axis, pattern.period].append((number, pattern))
    shortest = {axis: min(period for other, period in fringes if other == axis) for axis, _ in fringes}
    squares = list[float]()
    for axis, period in shortest.items():
        phasors = _of_passes(fringes[axis, period], weights, averaged)
        px_per_radian = period / (2 * math.pi)
        squares += [px_per_radian**2 * square for square in _squares_of_modes(phasors)]
    return _UNSEEN * math.sqrt(max(float(np.mean(squares)), 0.0)) if squares else None


def _of_passes(
    fringe: Sequence[tuple[int, Phase]], weights: Sequence[PictureWeights], averaged: Averaged
) -> NDArray[np.complex64]:
    """(2, h, w): amplitude and phase of a fringe there and back; 0 where a pass lacks one of its pictures."""
    total = np.zeros((2, *averaged.passes.shape[2:]), np.complex64)
    complete = np.ones(total.shape[1], np.bool_)
    for number, pattern in fringe:
        each, rows = weights[number], weights[number].weights[:, :: averaged.step]
        of_pass = np.stack([rows[~each.back].sum(axis=0), rows[each.back].sum(axis=0)])
        # Unmixed frames form a picture only together; some of their weights are negative.
        complete &= (rows >= 0).all(axis=0) & (of_pass > _LEAST_SHARE * of_pass.sum(axis=0)).all(axis=0)
        scale = (np.exp(-2j * np.pi * pattern.shift) / np.maximum(of_pass, 1e-6)).astype(np.complex64)
        total += averaged.passes[:, number] * scale[..., None]
    return total * complete[:, None]


def _squares_of_modes(phasors: NDArray[np.complex64]) -> list[float]:
    """For each part of the image that the fringe lights: the mean square of the amplitudes of smooth modes, without
    that of pixels that err independently; of half the phase in radians that separates both passes.
    """
    amplitude = np.abs(phasors).min(axis=0)
    lit = amplitude > _LEAST_AMPLITUDE * np.percentile(amplitude, _WELL_LIT)
    pixels = np.argwhere(lit)
    if len(pixels) < _FEWEST:
        return []
    half = np.angle(phasors[1] * np.conj(phasors[0]))[lit] / 2
    low, high = np.percentile(pixels, (2, 98), axis=0)
    part = np.clip((pixels - low) / (high - low + 1) * _PARTS, 0, _PARTS - 1).astype(np.intp) @ (_PARTS, 1)
    squares = []
    for number in range(_PARTS**2):
        of_part, at = half[part == number], pixels[part == number].astype(np.float64)
        if len(of_part) < _FEWEST:
            continue
        off = np.abs(of_part - np.median(of_part))
        kept = off <= _OUTLIER * np.median(off)
        modes = orthonormal_polynomials(at[kept])
        amplitudes = modes.T @ of_part[kept]
        rest = of_part[kept] - modes @ amplitudes
        squares.append(float(np.mean(amplitudes**2) - np.mean(rest**2)) / len(rest))
    return squares
