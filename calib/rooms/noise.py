"""How noisy the cells of each station are, and how far from flat each plane is, measured on the residuals of a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import MEDIAN_LENGTH, Floats, median
from calib.refinement import CUBIC, Cells, Noise, long_waves, noise_of, overdispersion
from calib.refinement.match_cells import joined
from calib.rooms.patches import Patch

_LEAST_PX = 1e-3
_OUT_OF_LINE = 4.0  # long waves of a patch over those of the station's median one: the plane's fault, not the decoder's
_BENT = 0.999


@dataclass(frozen=True, eq=False)
class Levels:
    """`stations`: the noise of each. `planes` (P,): by what factor the variances on a plane are larger, because it is
    bent, or because not all that was taken for it is one plane; 1 for a flat one.
    """

    stations: tuple[Noise, ...]
    planes: Floats

    def variances(self, patches: Sequence[Patch]) -> list[Floats]:
        """Of each coordinate of each cell, (M,) for each patch."""
        return [self.planes[patch.plane] * self.stations[patch.station].variances(patch.cells) for patch in patches]


def rough_levels(patches: Sequence[Patch], residuals: Sequence[Floats]) -> Floats:
    """One variance for all cells of each patch, that of its station's residuals, robustly, (patches,)."""
    stations = np.array([patch.station for patch in patches])
    levels = np.empty(len(patches))
    for station in np.unique(stations):
        own = np.flatnonzero(stations == station).tolist()
        sizes = np.concatenate([np.linalg.norm(residuals[i], axis=1) for i in own])
        levels[own] = max(median(sizes) / MEDIAN_LENGTH, _LEAST_PX) ** 2
    return levels


def measured(
    patches: Sequence[Patch], residuals: Sequence[Floats], free: int, repeats: Sequence[int], planes: int
) -> Levels:
    """From the residuals of a fit with so many free columns. `repeats`: how many stations stand where each stands.

    Long waves tell of smooth errors of a station, which all its patches show, and of planes that are not flat, which
    all stations that see them show: a station's overdispersion is measured without the patches that are out of line.
    """
    absorbed = free / len(patches)
    stations: list[Noise] = []
    totals = np.full(len(patches), np.nan)
    for station, times in enumerate(repeats):
        own = [i for i, patch in enumerate(patches) if patch.station == station]
        if not own:
            stations.append(Noise(np.nan, np.nan, np.nan, 1.0))
            continue
        cells = _together([patches[i].cells for i in own])
        noise = noise_of(cells, np.concatenate([residuals[i] for i in own]), absorbed * len(own))
        for i in own:
            independent = replace(noise, inflation=1.0).variances(patches[i].cells)
            totals[i] = long_waves(patches[i].cells, residuals[i], independent)[0][0]
        waves = totals[own][np.isfinite(totals[own])]
        usual = waves[waves <= _OUT_OF_LINE * np.median(waves)] if len(waves) else waves
        inflation = overdispersion(float(usual.sum()), len(usual) * (2 * CUBIC - absorbed))
        stations.append(replace(noise, inflation=inflation, repeats=times))
    return Levels(tuple(stations), _of_planes(patches, totals, stations, absorbed, planes))


def _of_planes(
    patches: Sequence[Patch], totals: Floats, stations: Sequence[Noise], absorbed: float, planes: int
) -> Floats:
    """By what factor each plane's patches vary more than their stations tell, (planes,)."""
    sums, freedom = np.zeros(planes), np.zeros(planes)
    for patch, total in zip(patches, totals, strict=True):
        if np.isfinite(total):
            sums[patch.plane] += total / stations[patch.station].inflation
            freedom[patch.plane] += 2 * CUBIC - absorbed
    return np.array([overdispersion(*each, _BENT) for each in zip(sums.tolist(), freedom.tolist(), strict=True)])


def _together(parts: Sequence[Cells]) -> Cells:
    whole = parts[0]
    for part in parts[1:]:
        whole = joined(whole, part)
    return whole
