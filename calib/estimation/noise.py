"""How noisy the cells of each station are, and how far from flat each plane is, measured on the residuals of a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.estimation.match_cells import Cells, joined
from calib.estimation.problem import AnyPlanes, Fit, PlanePart, Problem
from calib.estimation.scores import plane_scores
from calib.numerics import (
    CUBIC,
    MEDIAN_LENGTH,
    TERMS,
    Floats,
    Ints,
    huber_weights,
    median,
    monomials,
    normalisation,
    orthonormal_polynomials,
)

_SIGNIFICANT = 0.99
_LEAST_CELLS = 3 * CUBIC  # on a plane, to separate long waves from short ones
_LEAST_PX = 1e-3
_OUT_OF_LINE = 4.0  # long waves of a patch over the median of its station: beyond this, the plane is uneven
_BENT = 0.999
_LOUD = 10.0  # sigmas; a cell with a larger residual does not affect the smooth part further
_BLOCKS = 5  # blocks along either side of a view, within which errors correlate
_FEWEST_IN_BLOCK = 5


@dataclass(frozen=True)
class Noise:
    """Noise of one capture: the scatter of a match; τ, the systematic error of a cell's mean; the root mean square of
    the residuals' long waves; κ, their overdispersion: their variance over that expected from independent cells.

    Only long waves move the parameters, so κ is the factor by which their variances grow. `repeats`: number of captures
    taken from the same place. They have the same smooth errors, so together they count as one.
    """

    match_px: float
    systematic_px: float
    smooth_px: float
    inflation: float
    repeats: int = 1

    def variances(self, cells: Cells) -> Floats:
        """κ (σ² + τ²) of each coordinate of each cell, (M,), times the repeats."""
        return self.repeats * self.inflation * _independent(cells, self.systematic_px)


def noise_of(cells: Cells, residual: Floats, absorbed: float) -> Noise:
    """Estimate the noise from residuals (M, 2) of a fit that absorbed `absorbed` degrees of freedom of this capture."""
    systematic_px = _systematic(residual / cells.coarseness[:, None], cells.sigma_px / cells.coarseness)
    independent = _independent(cells, systematic_px)
    return Noise(cells.noise_px, systematic_px, *_long_waves(cells, residual, independent, absorbed))


def _independent(cells: Cells, systematic_px: float) -> Floats:
    return cells.sigma_px**2 + (systematic_px * cells.coarseness) ** 2


def _systematic(residual: Floats, sigma_px: Floats) -> float:
    """Return τ in px such that the median size of the residuals (M, 2) matches the variances σ² + τ² (robust)."""
    size, variance = np.linalg.norm(residual, axis=1), sigma_px**2
    low, high = 0.0, 2 * float(np.median(size)) + 1e-12
    for _ in range(50):
        middle = (low + high) / 2
        relative = size / np.sqrt(variance + middle**2)
        low, high = (middle, high) if median(relative) > MEDIAN_LENGTH else (low, middle)
    return high if high > 1e-3 * float(np.median(sigma_px)) else 0.0


def long_waves(cells: Cells, residual: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Project the residuals of each plane on cubic polynomials over it: χ² (P,), with 2 CUBIC degrees of freedom, and
    sum of squares (P,) in px², ordered by label; NaN for a plane with too few cells.
    """
    totals, squares = [], []
    for plane in np.unique(cells.plane):
        members = cells.plane == plane
        if members.sum() < _LEAST_CELLS:
            totals.append(np.nan)
            squares.append(np.nan)
            continue
        root = 1 / np.sqrt(variance[members])
        waves = orthonormal_polynomials(cells.camera_px[members], root)
        amplitudes = waves.T @ (residual[members] * root[:, None])
        totals.append(float(np.sum(amplitudes**2)))
        squares.append(float(np.sum((waves @ amplitudes / root[:, None]) ** 2)))
    return np.array(totals), np.array(squares)


def overdispersion(total: float, freedom: float, significant: float = _SIGNIFICANT) -> float:
    """Return κ, χ² over its degrees of freedom; 1 if it is not significant."""
    return 1.0 if freedom <= 0 or total < scipy.special.chdtri(freedom, 1 - significant) else total / freedom


def _long_waves(cells: Cells, residual: Floats, variance: Floats, absorbed: float) -> tuple[float, float]:
    """Return the root mean square, in px, of the residuals' projection on cubic polynomials over each plane, and κ."""
    totals, squares = long_waves(cells, residual, variance)
    freedom = 2 * CUBIC * np.count_nonzero(np.isfinite(totals)) - absorbed
    return float(np.sqrt(np.nansum(squares) / len(cells))), overdispersion(float(np.nansum(totals)), freedom)


UNKNOWN = Noise(np.nan, np.nan, np.nan, 1.0)  # for a station without cells


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """`stations`: the noise of each. `planes` (P,): factor on the variances on a plane that is bent or a mixture of
    planes; 1 for a flat one.

    `alike`: number of stations with the same smooth errors, such as those of lenses; variances of results are larger by
    this factor.
    """

    stations: tuple[Noise, ...]
    planes: Floats
    alike: float

    def variances(self, patches: Sequence[PlanePart[AnyPlanes]]) -> list[Floats]:
        """Of each coordinate of each cell, (M,) for each patch."""
        return [self.planes[patch.plane] * self.stations[patch.capture].variances(patch.cells) for patch in patches]


def rough_levels(patches: Sequence[PlanePart[AnyPlanes]], residuals: Sequence[Floats]) -> Floats:
    """One variance for all cells of each patch, that of its station's residuals, robustly, (patches,)."""
    stations = np.array([patch.capture for patch in patches])
    levels = np.empty(len(patches))
    for station in np.unique(stations):
        own = np.flatnonzero(stations == station).tolist()
        sizes = np.concatenate([np.linalg.norm(residuals[i], axis=1) for i in own])
        levels[own] = max(median(sizes) / MEDIAN_LENGTH, _LEAST_PX) ** 2
    return levels


def measured(
    problem: Problem[AnyPlanes, PlanePart[AnyPlanes]],
    fit: Fit[AnyPlanes],
    repeats: Sequence[int],
    *,
    one_rig: bool = True,
) -> NoiseLevels:
    """Noise levels from a problem's fit. `repeats`: number of stations at the place of each. `one_rig`: whether all
    captures are of the same two devices.

    Long waves have two causes: smooth errors of a station, in all its patches, and uneven planes, in all stations that
    see them. A station's overdispersion is measured without outlying patches. Ties measure the differences of planes
    between stations. Smooth errors that are equal at all stations are those of the lenses, and count once.
    """
    patches = problem.parts
    absorbed = np.count_nonzero(problem.free) / len(patches)
    waves = np.full(len(patches), np.nan)
    stations = []
    for station, times in enumerate(repeats):
        own = [i for i, patch in enumerate(patches) if patch.capture == station]
        cells, residuals = [patches[i].cells for i in own], [fit.residuals[i] for i in own]
        noise, waves[own] = of_station(cells, residuals, absorbed) if own else (UNKNOWN, np.nan)
        stations.append(replace(noise, repeats=times))
    further_stations = len({patch.capture for patch in patches}) - 1 if one_rig else 0
    alike = 1 + (_coherence(patches, fit, stations) * further_stations if further_stations else 0.0)
    flat = NoiseLevels(tuple(stations), np.ones(len(fit.state.planes)), alike)
    of_stations = np.array([stations[patch.capture].inflation for patch in patches])
    by_waves = _of_planes(patches, waves / of_stations, np.full(len(patches), 2 * CUBIC - absorbed), fit.state)
    scores, freedom = plane_scores(problem, fit, flat.variances(patches))
    by_ties = _overdispersions(scores.tolist(), freedom.tolist())
    return replace(flat, planes=np.maximum(by_waves, by_ties))


def of_station(patches: Sequence[Cells], residuals: Sequence[Floats], absorbed: float) -> tuple[Noise, Floats]:
    """A station's noise, from the cells and residuals of its patches; and the part of χ² in each patch's long waves.

    That part is NaN for patches that are too small.
    """
    noise = noise_of(_together(patches), np.concatenate(residuals), absorbed * len(patches))
    independent = replace(noise, inflation=1.0)
    waves = np.array(
        [
            long_waves(cells, residual, independent.variances(cells))[0][0]
            for cells, residual in zip(patches, residuals, strict=True)
        ]
    )
    known = waves[np.isfinite(waves)]
    usual = known[known <= _OUT_OF_LINE * np.median(known)] if len(known) else known
    inflation = overdispersion(float(usual.sum()), len(usual) * (2 * CUBIC - absorbed))
    return replace(noise, inflation=inflation), waves


def _coherence(patches: Sequence[PlanePart[AnyPlanes]], fit: Fit[AnyPlanes], stations: Sequence[Noise]) -> float:
    """From 0 to 1, how far smooth errors across the epipolar lines are equal at all stations.

    Across them, no plane can absorb an error, and no uneven plane causes one. The value is the share of the variance
    explained by polynomials of each station that common polynomials explain, corrected for chance.
    """
    scale = normalisation(np.concatenate([patch.cells.camera_px for patch in patches]))
    information, pull = np.zeros((len(stations), TERMS, TERMS)), np.zeros((len(stations), TERMS))
    for patch, residual in zip(patches, fit.residuals, strict=True):
        along = patch.predict(fit.state)[1][:, :, -1]
        across = along[:, 1] * residual[:, 0] - along[:, 0] * residual[:, 1]
        across /= np.linalg.norm(along, axis=1)
        weight = 1 / replace(stations[patch.capture], inflation=1.0, repeats=1).variances(patch.cells)
        weight *= huber_weights(np.abs(across) * np.sqrt(weight), _LOUD)
        terms = monomials(patch.cells.camera_px, scale)
        information[patch.capture] += (terms * weight[:, None]).T @ terms
        pull[patch.capture] += terms.T @ (weight * across)
    explained = np.array([_explained(*station_sums) for station_sums in zip(information, pull, strict=True)])
    if overdispersion(float(explained.sum()), float(TERMS * np.count_nonzero(explained)), _BENT) == 1.0:
        return 0.0
    chance = 1 / np.count_nonzero(explained)
    share = _explained(information.sum(axis=0), pull.sum(axis=0)) / explained.sum()
    return float(np.clip((share - chance) / max(1 - chance, chance), 0.0, 1.0))


def _explained(information: Floats, pull: Floats) -> float:
    """χ² of what polynomials explain."""
    return float(pull @ np.linalg.pinv(information, hermitian=True) @ pull)


def _of_planes(patches: Sequence[PlanePart[AnyPlanes]], totals: Floats, freedom: Floats, layout: AnyPlanes) -> Floats:
    """Factor on each plane's variances beyond those of the stations, (planes,), from χ² and its degrees of freedom."""
    planes = np.array([patch.plane for patch in patches])
    known = np.isfinite(totals)
    sums, free = (np.bincount(planes[known], summands[known], len(layout.planes)) for summands in (totals, freedom))
    return _overdispersions(sums.tolist(), free.tolist())


def _overdispersions(totals: Sequence[float], freedom: Sequence[float]) -> Floats:
    return np.array(
        [overdispersion(*total_and_freedom, _BENT) for total_and_freedom in zip(totals, freedom, strict=True)]
    )


def _together(parts: Sequence[Cells]) -> Cells:
    whole = parts[0]
    for part in parts[1:]:
        whole = joined(whole, part)
    return whole


def block_inflation(pixel: Floats, relative: Floats) -> float:
    """Factor on variances for errors (N,), in sigmas, that correlate within blocks of pixels (N, 2)."""
    block = blocks_of(pixel)
    count, total = np.bincount(block), np.bincount(block, relative)
    full = count >= _FEWEST_IN_BLOCK
    return max(1.0, float(np.mean(total[full] ** 2 / count[full]))) if full.any() else 1.0


def blocks_of(pixel: Floats) -> Ints:
    """The number (N,) of the block that each pixel (N, 2) is in."""
    place = ((pixel - pixel.min(axis=0)) / (np.ptp(pixel, axis=0) + 1e-9) * _BLOCKS).astype(np.int64)
    number: Ints = place[:, 0] * (_BLOCKS + 1) + place[:, 1]
    return number
