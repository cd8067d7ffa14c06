"""How noisy the cells of each station are, and how far from flat each plane is, measured on the residuals of a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import MEDIAN_LENGTH, Bools, Floats, median
from calib.refinement import CUBIC, Cells, Noise, long_waves, noise_of, overdispersion
from calib.refinement.match_cells import joined
from calib.rooms.likelihood import Fit
from calib.rooms.patches import Patch
from calib.rooms.room import Room
from calib.rooms.ties import tie_scores

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
    patches: Sequence[Patch], fit: Fit, variances: Sequence[Floats], free: Bools, repeats: Sequence[int]
) -> Levels:
    """From a fit under some variances of the cells. `repeats`: how many stations stand where each stands.

    Long waves tell of smooth errors of a station, which all its patches show, and of planes that are not flat, which
    all stations that see them show: a station's overdispersion is measured without the patches that are out of line.
    Planes that are flat where a station sees them may yet differ between stations: so do ties.
    """
    absorbed = np.count_nonzero(free) / len(patches)
    stations: list[Noise] = []
    waves = np.full(len(patches), np.nan)
    for station, times in enumerate(repeats):
        own = [i for i, patch in enumerate(patches) if patch.station == station]
        if not own:
            stations.append(Noise(np.nan, np.nan, np.nan, 1.0))
            continue
        cells = _together([patches[i].cells for i in own])
        noise = noise_of(cells, np.concatenate([fit.residuals[i] for i in own]), absorbed * len(own))
        for i in own:
            independent = replace(noise, inflation=1.0).variances(patches[i].cells)
            waves[i] = long_waves(patches[i].cells, fit.residuals[i], independent)[0][0]
        known = waves[own][np.isfinite(waves[own])]
        usual = known[known <= _OUT_OF_LINE * np.median(known)] if len(known) else known
        inflation = overdispersion(float(usual.sum()), len(usual) * (2 * CUBIC - absorbed))
        stations.append(replace(noise, inflation=inflation, repeats=times))
    flat = Levels(tuple(stations), np.ones(len(fit.room.planes)))
    of_stations = np.array([stations[patch.station].inflation for patch in patches])
    by_waves = _of_planes(patches, waves / of_stations, np.full(len(patches), 2 * CUBIC - absorbed), fit.room)
    scores, freedom = tie_scores(patches, fit, variances, free)
    lowered = [used.mean() / own.mean() for used, own in zip(variances, flat.variances(patches), strict=True)]
    by_ties = _of_planes(patches, scores * lowered, freedom, fit.room)
    return replace(flat, planes=np.maximum(by_waves, by_ties))


def _of_planes(patches: Sequence[Patch], totals: Floats, freedom: Floats, room: Room) -> Floats:
    """By what factor each plane's patches vary more than their stations tell, (planes,), from χ² and its freedom."""
    planes = np.array([patch.plane for patch in patches])
    told = np.isfinite(totals)
    sums, free = (np.bincount(planes[told], each[told], len(room.planes)) for each in (totals, freedom))
    return np.array([overdispersion(*each, _BENT) for each in zip(sums.tolist(), free.tolist(), strict=True)])


def _together(parts: Sequence[Cells]) -> Cells:
    whole = parts[0]
    for part in parts[1:]:
        whole = joined(whole, part)
    return whole
