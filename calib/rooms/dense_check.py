"""Whether dense surfaces coincide at the estimated poses, and stations whose rig differs by less than that shows.

Wrong planes, or mistaken parts of a wall, may leave small residuals and small sigmas, with poses off by many of these.
The distances between two clouds do not depend on such choices: the twist that would align them must be within the
covariance.

A projector that rotates by a fortieth of a degree moves its light by a tenth of a pixel. The room then explains it
partly, but the station's pose is off by a centimetre, because distances are off by several millimetres. All planes
together find it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from calib.estimation import ROBUST_SIGMAS, PatchSums, Score, block_inflation, blocks_of, reweighted, score
from calib.geometry import PER_POSE, Matches
from calib.numerics import Floats, huber_weights, robust_sigma
from calib.refinement import ROTATION, SHARED, TRANSLATION
from calib.rooms.estimate import RoomEstimate
from calib.rooms.factors import SMOOTH, Contact, Patch, find_contacts

_RADIUS = 0.01  # relative to the reach, as for the contacts
_ROUNDS = 5
_TURNING, _SHIFTING = slice(0, 3), slice(3, 6)
# Smooth errors of real decoders are known roughly, so sigmas are less reliable than for normal deviates.
_CALM = 1.5
_DOUBT = float(chdtri(PER_POSE, 1e-3))
_FAR, _FAR_SHARE, _FULL_BLOCK = 5.0, 0.06, 20  # sigmas, and share of displaced blocks; points of a full block


@dataclass(frozen=True)
class SurfaceDisplacement:
    """Stations `first` and `second` with displaced surfaces. `turn_deg`, `shift`: the displacement of the second, in
    degrees and baselines (of the middle of the common view), which is `sigmas` of the estimate.

    `apart`: share of the common surface that is displaced differently, because part of the scene moved.
    """

    first: int
    second: int
    turn_deg: float
    shift: float
    sigmas: float
    apart: float


def disagreements(matches: Sequence[Matches], estimate: RoomEstimate) -> list[SurfaceDisplacement]:
    """Of all pairs that share a surface; `matches`: all of each station's."""
    match_px = [noise.match_px for noise in estimate.levels.stations]
    contacts = find_contacts(matches, estimate.room, match_px, _RADIUS * estimate.reach, SMOOTH)
    displacements = [
        _compared(contact, estimate, (match_px[contact.first], match_px[contact.second])) for contact in contacts
    ]
    return [
        displacement for displacement in displacements if displacement.sigmas > 1 or displacement.apart > _FAR_SHARE
    ]


def _compared(contact: Contact, estimate: RoomEstimate, match_px: tuple[float, float]) -> SurfaceDisplacement:
    distances, by_room, by_pixels = contact.distances(estimate.room)
    noise = contact.noise_px(match_px)
    alone: Floats = np.sum((by_pixels * np.repeat(noise, 2, axis=1)) ** 2, axis=1)
    # Twist of the second station about the middle of the common view.
    columns = by_room[:, SHARED + PER_POSE :]
    middle = _middle(columns)
    by_twist = columns.copy()
    by_twist[:, _TURNING] -= np.cross(np.broadcast_to(middle, (len(columns), 3)), columns[:, _SHIFTING])
    twist: Floats = np.zeros(PER_POSE)
    variance = alone
    for _ in range(_ROUNDS):
        residual = distances + by_twist @ twist
        variance = alone * max(1.0, robust_sigma(residual / np.sqrt(alone)) ** 2)
        size = np.abs(residual) / np.sqrt(variance)
        weight: Floats = huber_weights(size, ROBUST_SIGMAS) / variance
        normal = (by_twist * weight[:, None]).T @ by_twist
        twist = -np.linalg.lstsq(normal, (by_twist * weight[:, None]).T @ distances, rcond=1e-9)[0].astype(np.float64)
    residual = distances + by_twist @ twist
    pixels = contact.matches[0].camera_px
    relative = residual / np.sqrt(variance)
    many = block_inflation(pixels, np.clip(relative, -ROBUST_SIGMAS, ROBUST_SIGMAS))
    weighted = (by_twist * (weight / many)[:, None]).T
    pull, allowed = weighted @ distances, weighted @ by_room
    at = contact.columns(estimate.room)
    covariance = allowed @ estimate.covariance[np.ix_(at, at)] @ allowed.T + weighted @ by_twist
    squared_sigmas = float(pull @ np.linalg.pinv(covariance, hermitian=True) @ pull)
    return SurfaceDisplacement(
        contact.first,
        contact.second,
        float(np.degrees(np.linalg.norm(twist[_TURNING]))),
        float(np.linalg.norm(twist[_SHIFTING])),
        float(np.sqrt(squared_sigmas / _DOUBT)) / _CALM,
        _apart(pixels, residual / np.sqrt(alone)),
    )


def _middle(columns: Floats) -> Floats:
    """Of the points (3,), by their derivatives (N, 6): cross(point, normal) and the normal."""
    turns, normals = columns[:, _TURNING], columns[:, _SHIFTING]
    cross = np.zeros((len(normals), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = normals[:, 2], -normals[:, 1], normals[:, 0]
    cross -= cross.transpose(0, 2, 1)
    return np.linalg.lstsq(cross.reshape(-1, 3), turns.reshape(-1), rcond=None)[0].astype(np.float64)


def _apart(pixels: Floats, relative: Floats) -> float:
    """Share of the blocks of the first's picture in which the surfaces are many sigmas apart, all in one way."""
    block = blocks_of(pixels)
    count = np.bincount(block)
    full = [relative[block == number] for number in np.flatnonzero(count >= _FULL_BLOCK)]
    return float(np.mean([abs(float(np.median(deviations))) > _FAR for deviations in full])) if full else 0.0


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
    flattened, sums = reweighted(estimate.problem, fit, range(len(patches)), flat)
    covariance = estimate.problem.covariance(flattened)
    step = -covariance @ flattened.gradient
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
        across[:, patch_sums.columns] += patch_sums.own.information[_MOTION] @ patch_sums.carried
    slope = np.sum([patch_sums.own.gradient[_MOTION] for patch_sums in own], axis=0)
    information = np.sum([patch_sums.own.information[_MOTION, _MOTION] for patch_sums in own], axis=0)
    return score(slope, information, across, covariance, step)


def _moved_px(score: Score, station: int, patches: Sequence[Patch], variances: Sequence[Floats]) -> float:
    """What a score is as a deviation of every cell's coordinates."""
    weight = sum(
        2 * float(np.sum(1 / patch_variances))
        for patch, patch_variances in zip(patches, variances, strict=True)
        if patch.station == station
    )
    return float(np.sqrt(score.value / weight))
