"""Footprint of a camera pixel: its covariance, and the bias that averaging over it causes in the coordinate.

A camera pixel averages the fringes over its footprint, weighted by brightness. To second order, the mean coordinate
over a footprint of covariance V is off by ∇x · V ∇ ln A + ½ V : ∇∇x, with A the fringe's amplitude. The first term is a
shift towards the brighter side. (For a Gaussian footprint it is exact: it is Tweedie's formula, Efron, JASA 106, 2011.)
At the edge of a poster, a floorboard or a shadow it is tenths of a pixel; where light falls off evenly over a wall it
is thousandths, all over the wall. The second term comes from surface curvature. It is zero on planes; at the rim of a
ball it is a tenth of a projector pixel, always to the same side, so that balls would come out too small.

The shift at brightness edges is linear in the covariance, which is therefore estimated from them, and taken as constant
over the image. Lens blur is isotropic; camera shake during the exposure blurs along one direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from math import hypot
from typing import cast

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from calib.numerics import SIGMA_PER_MEDIAN, Bools, Floats, Floats32, Image, compiled, huber_weights, in_parallel
from scanner.decoding.significance import BY_CHANCE, MEDIAN_ROUNDS, SIGNIFICANT_SIGMAS

CROSS = np.asarray(cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), np.uint8)
# Radius of the window in which curvature is fitted, and within which a known shift is copied beside an edge.
_REACH = 2
_STRETCH = 64  # pixels of a row that are searched at once
REACH_PX = 2 * _REACH
# Largest second difference of a surface's coordinates; more is a step between surfaces, which fringe orders are not.
MOST_BEND_PX = 1.0
# Share of a shift that stays uncertain: finite differences at sharp edges, and neglected higher orders.
_UNCERTAIN_SHARE2 = np.float32(0.35**2)
_ZERO, _AS_IT_IS, _UNKNOWN = np.float32(0), np.float32(1), np.float32(np.nan)


@dataclass(frozen=True)
class Footprint:
    """The covariance of a camera pixel's footprint, in square camera pixels: column variance, row
    variance, covariance.
    """

    across_px2: float
    down_px2: float
    mixed_px2: float = 0.0

    @classmethod
    def round(cls, variance_px2: float) -> "Footprint":
        """Return an isotropic footprint."""
        return cls(variance_px2, variance_px2)

    @property
    def largest_px2(self) -> float:
        """The variance along the principal axis."""
        half = (self.across_px2 - self.down_px2) / 2
        return (self.across_px2 + self.down_px2) / 2 + hypot(half, self.mixed_px2)


# Basis of all covariances.
UNITS = Footprint(1, 0), Footprint(0, 1), Footprint(0, 0, 1)


def log_amplitude(power: Floats32) -> Floats32:
    """Return the logarithm of the amplitude from its square, any shape."""
    result = np.empty_like(power)
    cv2.log(power.reshape(1, -1), result.reshape(1, -1))
    result *= np.float32(0.5)
    return result


def surrounded(usable: Bools, window: Image) -> Bools:
    """Return the pixels (H, W) around which the whole window is usable."""
    whole = cv2.erode(usable.view(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return whole.view(np.bool_)


def shading_shift(
    value: Floats32, log_amplitude: Floats32, usable: Bools, footprint: Footprint, unknown: float = 0.0
) -> Floats32:
    """Return ∇x · V ∇ ln A (H, W), by central differences; `unknown` along the border and beside unusable pixels."""
    shift = np.full_like(value, unknown)
    across, down, mixed = (np.float32(v / 4) for v in (footprint.across_px2, footprint.down_px2, footprint.mixed_px2))
    _multiply_slopes(value, log_amplitude, surrounded(usable, CROSS), across, down, mixed, shift)
    return shift


@compiled
def _multiply_slopes(
    value: Floats32,
    log_amplitude: Floats32,
    chosen: Bools,
    across: np.float32,
    down: np.float32,
    mixed: np.float32,
    shift: Floats32,
) -> None:
    """Compute, at chosen pixels (H, W), none of them on the border, the products of the differences of neighbours."""
    height, width = value.shape
    for row in range(1, height - 1):
        above, here, below, is_chosen = value[row - 1], value[row], value[row + 1], chosen[row]
        log_above, log_here, log_below = log_amplitude[row - 1], log_amplitude[row], log_amplitude[row + 1]
        into = shift[row]
        for i in range(1, width - 1):
            right, lower = here[i + 1] - here[i - 1], below[i] - above[i]
            log_right, log_lower = log_here[i + 1] - log_here[i - 1], log_below[i] - log_above[i]
            total = right * (across * log_right + mixed * log_lower) + lower * (down * log_lower + mixed * log_right)
            into[i] = total if is_chosen[i] else into[i]


def correct_shading_shift(
    value: Floats32, variance: Floats32, log_amplitude: Floats32, usable: Bools, footprint: Footprint
) -> Floats32:
    """Subtract the shift towards the brighter side, and add its uncertainty to the variance; (H, W), in place.

    Returns the shift, NaN beside unusable pixels, where it is unknown.
    """
    shift = shading_shift(value, log_amplitude, usable, footprint, np.nan)
    _take_out(shift.ravel(), value.ravel(), variance.ravel(), _AS_IT_IS)
    return shift


def correct_curvature_shift(
    value: Floats32,
    variance: Floats32,
    of_shading: Floats32,
    surface: Bools,
    footprint: Footprint,
    wanted: tuple[slice, slice] = (slice(None), slice(None)),
) -> None:
    """Subtract the shift by surface curvature, and estimate the shading shift beside edges; (H, W), in place.

    Neighbouring pixels of `surface` see the same surface. Only the `wanted` rows and columns, all by default, are
    correct afterwards: along the border the neighbours are unknown.
    """
    _take_out_as_around(of_shading, surface, value, variance, *_limits(wanted, value.shape, REACH_PX))
    # The variance of a position in the window: a parabola does not fit the surface over a footprint as wide as that.
    if not 0 < footprint.largest_px2 < _REACH * (_REACH + 1) / 3:
        return
    kernel = curvature_kernel(footprint)
    shift = cast(Floats32, cv2.filter2D(value, cv2.CV_32F, kernel))
    most = np.float32(0.5 * footprint.largest_px2 * MOST_BEND_PX)
    _forget(shift.ravel(), surrounded(surface, np.ones_like(kernel, np.uint8)).ravel(), most)
    _take_out(shift.ravel(), value.ravel(), variance.ravel(), noise_gain2(kernel))
    _take_out_as_around(shift, surface, value, variance, *_limits(wanted, value.shape, 0))


def _limits(wanted: tuple[slice, slice], shape: tuple[int, ...], by: int) -> tuple[int, int, int, int]:
    """Return first row, end row, first column, end column of the wanted part widened by `by` pixels."""
    (top, bottom, _), (first_column, right, _) = (part.indices(size) for part, size in zip(wanted, shape, strict=True))
    return max(0, top - by), min(shape[0], bottom + by), max(0, first_column - by), min(shape[1], right + by)


@cache
def curvature_kernel(footprint: Footprint) -> NDArray[np.float32]:
    """Return the kernel that gives ½ V : ∇∇x from the values around a pixel, by a least-squares parabola."""
    u = np.arange(-_REACH, _REACH + 1, dtype=np.float64)
    ones, bend = np.ones_like(u), u**2 - np.mean(u**2)
    second = 2 * bend / np.sum(bend**2) / len(u)
    slope = u / np.sum(u**2)
    kernel = 0.5 * footprint.across_px2 * np.outer(ones, second) + 0.5 * footprint.down_px2 * np.outer(second, ones)
    return np.asarray(kernel + footprint.mixed_px2 * np.outer(slope, slope), np.float32)


def noise_gain2(kernel: NDArray[np.float32]) -> np.float32:
    """Return the factor by which subtracting the kernel's output increases the variance of independent noise."""
    residual = -kernel.astype(np.float64)
    residual[_REACH, _REACH] += 1
    return np.float32(np.sum(residual**2))


@compiled
def _forget(shift: Floats32, known: Bools, most: np.float32) -> None:
    """Set unknown or impossibly large shifts (P,) to NaN."""
    for i in range(len(shift)):
        shift[i] = shift[i] if known[i] & (abs(shift[i]) < most) else _UNKNOWN


@compiled
def _take_out(shift: Floats32, value: Floats32, variance: Floats32, gain: np.float32) -> None:
    """Subtract the known shifts (P,); the variance of independent noise grows by `gain`."""
    for i in range(len(shift)):
        own, is_known = shift[i], shift[i] == shift[i]
        value[i] -= own if is_known else _ZERO
        variance[i] = gain * variance[i] + _UNCERTAIN_SHARE2 * own * own if is_known else variance[i]


@compiled
def _take_out_as_around(
    shift: Floats32,
    surface: Bools,
    value: Floats32,
    variance: Floats32,
    top: int,
    bottom: int,
    first_column: int,
    right: int,
) -> None:
    """Where the shift is unknown, subtract the mean of the known shifts nearby on the surface, if there are any.

    In rows from `top` to `bottom`, columns from `first_column` to `right`.
    """
    for row in range(top, bottom):
        for start in range(first_column, right, _STRETCH):
            stop = min(start + _STRETCH, right)
            # Most stretches have none, which a vectorised loop finds out.
            of_surface, of_shift, unknown = surface[row, start:stop], shift[row, start:stop], np.uint8(0)
            for i in range(len(of_shift)):
                unknown |= np.uint8(of_surface[i] & (of_shift[i] != of_shift[i]))
            for i in range(start, stop if unknown else start):
                if surface[row, i] and shift[row, i] != shift[row, i]:
                    mean = _mean_around(shift, surface, row, i)
                    value[row, i] -= mean
                    # At the rim of a surface the shift is larger than at the neighbours.
                    variance[row, i] += mean * mean


@compiled
def _mean_around(shift: Floats32, surface: Bools, row: int, column: int) -> np.float32:
    """Return the mean of the known shifts of the surface nearby, 0 if there are none."""
    height, width = shift.shape
    total, count = _ZERO, _ZERO
    for r in range(max(0, row - _REACH), min(height, row + _REACH + 1)):
        for c in range(max(0, column - _REACH), min(width, column + _REACH + 1)):
            if surface[r, c] and shift[r, c] == shift[r, c]:
                total += shift[r, c]
                count += _AS_IT_IS
    return total / count if count else _ZERO


_FINE_PX, _COARSE_PX = 3, 9
# A surface bends less than this over the coarse window, in projector pixels; a wrong fringe order jumps more.
_JUMP_PX = 0.5
# Three standard deviations of a larger footprint would reach beyond the coarse window.
_LARGEST_PX2 = 9.0
# Default where the capture does not determine it: a pixel's own area (1/12) behind a lens that blurs by a third of a
# pixel. For a plain wall, zero would be a worse guess with any lens.
TYPICAL_PX2, _TYPICAL_SIGMA_PX2 = 0.2, 0.15
# Parallel edges do not determine the variance along them.
_LARGEST_CONDITION = 100.0


@dataclass(frozen=True)
class _Tiles:
    """Normal equations of the covariance in `UNITS`, per tile: `matrix` (T, 3, 3) and `vector` (T, 3)."""

    matrix: Floats
    vector: Floats


def footprint_of(
    shaded: Sequence[tuple[Floats32, Floats32]], log_lit: Floats32, usable: Bools, tile_px: int, assumed_px2: float
) -> Footprint:
    """Estimate the footprint: isotropic unless the capture shows otherwise; `assumed_px2` if it is not determined.

    `shaded`: for one or both axes, the coordinate and the logarithm of its amplitude. `log_lit`: logarithm of the grey
    level in full light. All are square tiles of `tile_px` stacked vertically, (T · tile, tile).
    """
    tiles = _equations(shaded, log_lit, usable, tile_px)
    # An isotropic footprint has equal variances.
    shift, weight = tiles.vector[:, :2].sum(axis=1), tiles.matrix[:, :2, :2].sum(axis=(1, 2))
    telling = weight > 0
    if np.count_nonzero(telling) <= len(UNITS):
        return Footprint.round(assumed_px2)
    long = _not_round(_Tiles(tiles.matrix[telling], tiles.vector[telling]))
    if long is not None:
        return long
    variance, scatter = _weighted_median(shift[telling] / weight[telling], weight[telling])
    if assumed_px2 and abs(variance) <= SIGNIFICANT_SIGMAS * scatter:
        share = _TYPICAL_SIGMA_PX2**2 / (_TYPICAL_SIGMA_PX2**2 + scatter**2)
        return Footprint.round(assumed_px2 + share * (variance - assumed_px2))
    return Footprint.round(min(variance, _LARGEST_PX2) if variance > SIGNIFICANT_SIGMAS * scatter else assumed_px2)


def _equations(shaded: Sequence[tuple[Floats32, Floats32]], log_lit: Floats32, usable: Bools, tile_px: int) -> _Tiles:
    bends = [_band(value) for value, _ in shaded]
    inner = _inner(usable & np.all([np.abs(bend) < _JUMP_PX for bend in bends], axis=0), tile_px)
    count, chosen = len(UNITS), inner.astype(np.float32)
    rows = 2 * count + 1

    def products(axis: int) -> Floats32:
        value, log_amplitude = shaded[axis]
        images = np.empty((rows, *usable.shape), np.float32)
        # Instrumental variable: it depends on the albedo, but neither on the noise of the amplitude nor on the
        # correlated ripples that interreflection causes in amplitude and phase.
        for image, (of, unit) in zip(images, product((log_lit, log_amplitude), UNITS), strict=False):
            np.multiply(_band(shading_shift(value, of, usable, unit)), chosen, out=image)
        np.multiply(bends[axis], chosen, out=images[-1])
        tiles = images.reshape(rows, -1, tile_px**2).swapaxes(0, 1)
        return tiles @ tiles.swapaxes(1, 2)

    of_both = np.stack(in_parallel(products, range(len(shaded)))).sum(axis=0, dtype=np.float64)
    return _Tiles(of_both[:, :count, count:-1], of_both[:, :count, -1])


def _not_round(tiles: _Tiles) -> Footprint | None:
    """Return an anisotropic footprint; None if the data agree with an isotropic one.

    Weights turn the mean over tiles into a median (Weiszfeld). The covariance of the estimate comes from the tiles'
    scatter, and the test is Hotelling's, which accounts for their small number. No tile has more weight than the median
    tile, so that an error in a few strong edges does not decide.
    """
    unknowns = tiles.vector.shape[1]
    information = np.trace(tiles.matrix, axis1=1, axis2=2)
    share = np.minimum(1, np.median(information) / information)
    tiles = _Tiles(tiles.matrix * share[:, None, None], tiles.vector * share[:, None])
    information *= share
    count = float(information.sum() ** 2 / np.sum(information**2))
    if count <= 2 * unknowns or np.linalg.cond(tiles.matrix.sum(axis=0)) > _LARGEST_CONDITION:
        return None
    size = np.sqrt(np.maximum(information, np.finfo(float).tiny))
    weight = np.ones(len(size))
    for _ in range(MEDIAN_ROUNDS):
        total = np.einsum("t,tij->ij", weight, tiles.matrix)
        covariance = np.linalg.solve(total, weight @ tiles.vector)
        residual = tiles.vector - tiles.matrix @ covariance
        off = np.linalg.norm(residual, axis=1) / size
        weight = huber_weights(off, float(np.median(off)))
    response = np.linalg.solve(total, (weight[:, None] * residual).T)
    uncertain = response @ response.T
    # Difference of the variances, and the covariance: both are zero for an isotropic footprint.
    apart = np.array([[1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    difference = apart @ covariance
    squared = float(difference @ np.linalg.solve(apart @ uncertain @ apart.T, difference))
    free = count - unknowns
    by_chance = scipy.special.fdtrc(2, free - 1, squared * (free - 1) / (2 * free))
    footprint = Footprint(*covariance.tolist())
    return footprint if by_chance < BY_CHANCE and footprint.largest_px2 < _LARGEST_PX2 else None


def _weighted_median(values: Floats, weights: Floats) -> tuple[float, float]:
    """Return the weighted median and its standard deviation, from the scatter of the values about it."""

    def median(of: Floats) -> float:
        order = np.argsort(of)
        cumulated = np.cumsum(weights[order])
        return float(of[order][np.searchsorted(cumulated, cumulated[-1] / 2)])

    middle = median(values)
    effective_count = weights.sum() ** 2 / np.sum(weights**2)
    # The standard deviation of a median of n normal deviates is √(π / 2n) of theirs.
    sigma = SIGMA_PER_MEDIAN * median(np.abs(values - middle))
    return middle, sigma * float(np.sqrt(np.pi / 2 / effective_count))


def _band(image: Floats32) -> Floats32:
    """Band-pass filter an image: remove the noise of single pixels and the slope of the surface."""
    fine, coarse = (cv2.blur(image, (size, size)) for size in (_FINE_PX, _COARSE_PX))
    return np.asarray(fine - coarse, np.float32)


def _inner(usable: Bools, tile_px: int) -> Bools:
    """Return the pixels of each tile whose windows lie in the tile and hold only usable pixels."""
    margin = _COARSE_PX // 2 + 2  # one for the derivatives, and one that sees two surfaces
    size = 2 * margin + 1
    whole = cv2.erode(usable.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    tiles = whole.reshape(-1, tile_px, tile_px)
    inside: Bools = np.zeros_like(tiles)
    middle = slice(margin, tile_px - margin)
    inside[:, middle, middle] = tiles[:, middle, middle]
    return inside.reshape(usable.shape)
