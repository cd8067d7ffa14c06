"""Estimate the covariance of a camera pixel's footprint from the coordinate shifts at brightness edges.

The shift at such edges is linear in the covariance (`footprint_shift`). The covariance is taken as constant over
the image. Lens blur is isotropic; camera shake during the exposure blurs along one direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from scipy.special import fdtrc

from calib.numerics import SIGMA_PER_MEDIAN, Bools, Floats, Floats32, huber_weights, in_parallel
from scanner.decoding.fringes.footprint_shift import UNITS, Footprint, shading_shift
from scanner.decoding.significance import BY_CHANCE, MEDIAN_ROUNDS, SIGNIFICANT_SIGMAS

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
    by_chance = fdtrc(2, free - 1, squared * (free - 1) / (2 * free))
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
