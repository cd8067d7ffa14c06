"""Stations whose rig differs from the others' by too little for the surfaces, found by all planes together.

A projector that rotates by a fortieth of a degree moves its light by a tenth of a pixel. The room then explains it
partly, but the station's pose is off by a centimetre, because distances are off by several millimetres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import PatchSums, Score, reweighted, score
from calib.numerics import Floats
from calib.refinement import ROTATION, TRANSLATION, covariance_of
from calib.rooms.estimate import RoomEstimate
from calib.rooms.patches import Patch

_MOTION = slice(ROTATION.start, TRANSLATION.stop)
_FEWEST = 3  # of two stations, either one may be the changed one
_SURE = 100.0  # χ² of five degrees of freedom
_TIMES_USUAL = 4.0
_LEAST_PX = 0.01


@dataclass(frozen=True)
class TurnedRig:
    """Rotation of the projector against the camera before a `station`; `px`: the displacement of its light, root mean
    square in projector px, that no pose of the station compensates.
    """

    station: int
    turn_deg: float
    px: float


def changed_extrinsics(estimate: RoomEstimate) -> tuple[TurnedRig, ...]:
    """Stations that a separate rig would explain far better, relative to those that it explains least."""
    patches, fit = estimate.patches, estimate.fit
    stations = sorted({patch.station for patch in patches})
    if len(stations) < _FEWEST:
        return ()
    flat = _flat(estimate)
    used = estimate.levels.variances(patches)
    gradient, information, sums = reweighted(patches, fit, range(len(patches)), used, flat)
    variance = np.diag(estimate.covariance)
    covariance = covariance_of(information, np.isfinite(variance) & (variance > 0))
    step = -covariance @ gradient
    scores = [_of_station(k, patches, sums, covariance, step) for k in stations]
    px = [_moved_px(score, k, patches, flat) for score, k in zip(scores, stations, strict=True)]
    usual_px = sorted(px)[(len(px) - 1) // 2]
    return tuple(
        TurnedRig(k, float(np.degrees(np.linalg.norm(score.step[:3]))), own_px)
        for k, score, own_px in zip(stations, scores, px, strict=True)
        if score.value > _SURE and own_px > max(_LEAST_PX, _TIMES_USUAL * usual_px)
    )


def _flat(estimate: RoomEstimate) -> list[Floats]:
    """Variances of cells that err by noise alone: what does not fit must not be given less weight for that."""
    noise = [replace(station_levels, inflation=1.0) for station_levels in estimate.levels.stations]
    return [noise[patch.station].variances(patch.cells) for patch in estimate.patches]


def _of_station(
    station: int, patches: Sequence[Patch], sums: Sequence[PatchSums], covariance: Floats, step: Floats
) -> Score:
    """Of a motion between its camera and its projector that is its own."""
    own = [patch_sums for patch, patch_sums in zip(patches, sums, strict=True) if patch.station == station]
    across = np.zeros((_MOTION.stop - _MOTION.start, len(step)))
    for patch_sums in own:
        across[:, patch_sums.columns] += patch_sums.information[_MOTION] @ patch_sums.by_room
    slope = np.sum([patch_sums.slope[_MOTION] for patch_sums in own], axis=0)
    information = np.sum([patch_sums.information[_MOTION, _MOTION] for patch_sums in own], axis=0)
    return score(slope, information, across, covariance, step)


def _moved_px(score: Score, station: int, patches: Sequence[Patch], variances: Sequence[Floats]) -> float:
    """What a score is as a deviation of every cell's coordinates."""
    weight = sum(
        2 * float(np.sum(1 / patch_variances))
        for patch, patch_variances in zip(patches, variances, strict=True)
        if patch.station == station
    )
    return float(np.sqrt(score.value / weight))
