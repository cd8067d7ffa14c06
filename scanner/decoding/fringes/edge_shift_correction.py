"""The shift that a change of brightness makes where lens and pixel average over an area.

A camera pixel sees the fringes of its footprint, weighted by how bright each part is, so its coordinate is that of the
brighter side: x is too large by v ∇x · ∇ ln A, with A the fringe's amplitude and v the footprint's variance along an
axis. (For a Gaussian footprint this is exact: it is Tweedie's formula, Efron, JASA 106, 2011.) At the edge of a poster,
of a floorboard or of a shadow it is tenths of a pixel, always to the same side; where light falls off evenly over a
wall it is thousandths, all over the wall. The variance is the same all over the image, and is measured where the
capture has such edges.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Bools, Floats, compiled
from scanner.decoding.arrays import Floats32

# Central differences at the sharpest edges, and what the first order leaves: share of the shift that stays uncertain.
_UNCERTAIN_SHARE2 = np.float32(0.35**2)
_ZERO, _QUARTER = np.float32(0), np.float32(0.25)
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_FINE_PX, _COARSE_PX = 3, 9
_MARGIN_PX = 6
# No surface bends this much, in projector pixels, over the coarse window; a wrong fringe order does.
_JUMP_PX = 0.5
_FEWEST_TILES = 4
# Standard deviation of a median of n normal deviates, times √n, over their median deviation from it.
_MEDIAN_SIGMA = 1.2533 * SIGMA_PER_MEDIAN
_SIGNIFICANT = 5.0
_LARGEST_PX2 = 9.0
# Where a capture does not show it: a pixel's own area (1/12) behind a lens that blurs by a third of a pixel. Of a plain
# wall a variance of none is further off, whatever the lens.
TYPICAL_PX2 = 0.2


def log_amplitude(power: Floats32) -> Floats32:
    """Its logarithm from the square of the amplitude, any shape."""
    result = np.empty_like(power)
    cv2.log(power.reshape(1, -1), result.reshape(1, -1))
    result *= np.float32(0.5)
    return result


def shift_per_variance(value: Floats32, log_amplitude: Floats32, usable: Bools) -> Floats32:
    """∇x · ∇ ln A (H, W), by central differences; zero along the border and beside unusable pixels."""
    surrounded = cv2.erode(usable.view(np.uint8), _CROSS, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    shift = np.zeros_like(value)
    _add_products(value, log_amplitude, surrounded.view(np.bool_), 0, 1, shift)
    _add_products(value, log_amplitude, surrounded.view(np.bool_), 1, 0, shift)
    return shift


def straighten(
    value: Floats32, variance: Floats32, log_amplitude: Floats32, usable: Bools, footprint_px2: float
) -> None:
    """Take out what shading shifts a coordinate, and be less sure of what was shifted; (H, W), in place."""
    shift = shift_per_variance(value, log_amplitude, usable)
    _take_out(shift.ravel(), np.float32(footprint_px2), value.ravel(), variance.ravel())


@compiled
def _add_products(
    value: Floats32, log_amplitude: Floats32, chosen: Bools, down: int, across: int, sums: Floats32
) -> None:
    """Add, at chosen pixels, the product of the two slopes along a column or along a row."""
    height, width = value.shape
    for row in range(down, height - down):
        above, left, right = row - down, width - 2 * across, 2 * across
        value_before, value_after = value[above, :left], value[row + down, right:]
        log_before, log_after = log_amplitude[above, :left], log_amplitude[row + down, right:]
        is_chosen, total = chosen[row, across : width - across], sums[row, across : width - across]
        for i in range(len(total)):
            product = (value_after[i] - value_before[i]) * (log_after[i] - log_before[i])
            total[i] += _QUARTER * product if is_chosen[i] else _ZERO


@compiled
def _take_out(shift: Floats32, footprint_px2: np.float32, value: Floats32, variance: Floats32) -> None:
    for i in range(len(shift)):
        by = footprint_px2 * shift[i]
        value[i] -= by
        variance[i] += _UNCERTAIN_SHARE2 * by * by


def footprint_variance(
    shaded: Sequence[tuple[Floats32, Floats32]], log_lit: Floats32, usable: Bools, tile_px: int, assumed_px2: float
) -> float:
    """The footprint's variance along an axis, in square camera pixels; `assumed_px2` if the capture does not show it.

    `shaded`: of one or both axes, the coordinate and the logarithm of its amplitude; `log_lit`: that of the grey level
    in full light; in square tiles of `tile_px` one above the other, (T · tile, tile).
    """
    bends = [_band(value) for value, _ in shaded]
    inner = _inner(usable & np.all([np.abs(bend) < _JUMP_PX for bend in bends], axis=0), tile_px)
    found, weight = np.zeros((2, len(usable) // tile_px))
    for bend, (value, log_amplitude) in zip(bends, shaded, strict=True):
        # An instrument: it knows the paint, but not the noise of the amplitude, nor the ripples of amplitude and phase
        # that go with each other where light has bounced.
        instrument = _band(shift_per_variance(value, log_lit, usable))
        found += _sums(instrument * bend, inner, tile_px)
        weight += _sums(instrument * _band(shift_per_variance(value, log_amplitude, usable)), inner, tile_px)
    telling = weight > 0
    if np.count_nonzero(telling) < _FEWEST_TILES:
        return assumed_px2
    variance, scatter = _weighted_median(found[telling] / weight[telling], weight[telling])
    return min(variance, _LARGEST_PX2) if variance > _SIGNIFICANT * scatter else assumed_px2


def _weighted_median(values: Floats, weights: Floats) -> tuple[float, float]:
    """The weighted median and its standard deviation, from the scatter of the values about it."""

    def median(of: Floats) -> float:
        order = np.argsort(of)
        cumulated = np.cumsum(weights[order])
        return float(of[order][np.searchsorted(cumulated, cumulated[-1] / 2)])

    middle = median(values)
    effective_count = weights.sum() ** 2 / np.sum(weights**2)
    return middle, _MEDIAN_SIGMA * median(np.abs(values - middle)) / float(np.sqrt(effective_count))


def _band(image: Floats32) -> Floats32:
    """What is left of an image between two scales: no noise of single pixels, no slope of the surface."""
    fine, coarse = (cv2.blur(image, (size, size)) for size in (_FINE_PX, _COARSE_PX))
    return np.asarray(fine - coarse, np.float32)


def _inner(usable: Bools, tile_px: int) -> Bools:
    """Pixels of each tile whose windows are in it and hold nothing unusable."""
    size = 2 * _MARGIN_PX + 1
    whole = cv2.erode(usable.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    tiles = whole.reshape(-1, tile_px, tile_px)
    inside: Bools = np.zeros_like(tiles)
    middle = slice(_MARGIN_PX, tile_px - _MARGIN_PX)
    inside[:, middle, middle] = tiles[:, middle, middle]
    return inside.reshape(usable.shape)


def _sums(values: Floats32, chosen: Bools, tile_px: int) -> Floats:
    tiles = np.where(chosen, values, np.float32(0)).reshape(-1, tile_px**2)
    sums: Floats = tiles.sum(axis=1, dtype=np.float64)
    return sums
