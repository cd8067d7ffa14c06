"""One maximum-likelihood estimate of a rig, its poses in a room and the room's planes, from all stations' matches.

Planes that several stations see connect them. Walls seen from several places determine their angles, which a single
corner has to assume. A plane that one station sees contributes, too: its flatness constrains the rig.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.estimation import (
    Cells,
    Fit,
    NoiseLevels,
    Shifts,
    covariance_of_shifts,
    covariance_of_waves,
    measured,
    rough_levels,
)
from calib.geometry import Matches, Plane, Pose
from calib.numerics import Floats
from calib.refinement import SHARED, SQUARENESS_DEG, WEAK_TERMS, State
from calib.rooms.factors import Contact, Patch, Track, find_contacts, patches_of
from calib.rooms.point_tracking import LabelledPicture, find_tracks
from calib.rooms.priors import RigPrior, RoomPrior
from calib.rooms.room import Room
from calib.rooms.rough_fit import RoomProblem, fit_roughly, in_front, seen, without_wrong_ties

_ROUGH = 0.01  # tolerance in cost while noise is measured
_ROUNDS = 3
_TRACKING_ROUNDS = 2  # rounds; tracks from better poses are more accurate
_FREE_ROTATION = 1.0  # sigma of an unconstrained rotation, in radians
_UNDETERMINED = 0.1  # radians, and relative to the reach: a less certain direction is undetermined
NEAR = (0.02, 0.01, 0.005, 0.005)  # over the reach: distance of points of two stations that may be on one surface
_SAME_PLACE = 0.01  # relative to the reach, and radians


@dataclass(frozen=True, eq=False)
class Undetermined:
    """A direction of a station's pose that the planes leave undetermined.

    `direction` (3,): unit vector in the room's frame, along which it can slide, or about which it can rotate; `sigma`
    in baselines or radians.
    """

    station: int
    turning: bool
    direction: Floats
    sigma: float


@dataclass(frozen=True, eq=False)
class RoomEstimate:
    """`covariance` (size, size): of the room's columns; NaN for planes without a cell, 0 for fixed parameters.

    `residual_px` (S,): robust root mean square of each coordinate of a station's cells; NaN without cells. `reach`:
    median distance of surfaces from the camera, in baselines. `waves` (P,): unevenness of each plane, root mean square,
    in baselines; 0 if undetected. `contacts`: of surfaces that are no planes.
    """

    problem: RoomProblem
    fit: Fit[Room]
    covariance: Floats
    levels: NoiseLevels
    residual_px: Floats
    undetermined: tuple[Undetermined, ...]
    reach: float
    waves: Floats
    contacts: tuple[Contact, ...]

    @property
    def room(self) -> Room:
        """The most likely one; the first station is where the start had it."""
        return self.fit.state

    @property
    def patches(self) -> Sequence[Patch]:
        """The room's plane of each station's cells; planes after those of the start belong to stations that see another
        plane than the one assigned.
        """
        return self.problem.parts

    @property
    def rig_covariance(self) -> Floats:
        """(21, 21), of the room's rig, as of a calibration."""
        return self.covariance[:SHARED, :SHARED]

    def place_covariance(self, station: int) -> Floats:
        """(6, 6): rotation about the room's axes in radians, translation in baselines, against the first station."""
        columns = self.room.place_columns(station)
        return self.covariance[columns, columns]

    @cached_property
    def stations_of(self) -> tuple[tuple[int, ...], ...]:
        """For each plane the stations with cells on it."""
        stations: list[set[int]] = [set() for _ in self.room.planes]
        for patch in self.patches:
            stations[patch.plane].add(patch.station)
        return tuple(tuple(sorted(on_plane)) for on_plane in stations)


def estimate_room(
    stations: Sequence[Cells],
    plane_of: Sequence[Sequence[int]],
    places: Sequence[Pose],
    planes: Sequence[Plane],
    start: State,
    prior: RigPrior,
    *,
    square: Sequence[tuple[int, int]] = (),
    squareness_deg: float = SQUARENESS_DEG,
    shifts: Sequence[Shifts] = (),
    place_sigma: tuple[float, float] | None = None,
    loose: Sequence[Matches] = (),
    sights: Sequence[LabelledPicture | None] = (),
) -> RoomEstimate:
    """Estimate from a start: the calibrated rig, `places` of stations and `planes` as registered, in baselines.

    `stations`: the cells of each, whose labels `plane_of` maps to the room's planes (−1: none). `square`: pairs of
    perpendicular planes, with `squareness_deg` as standard deviation; other angles are free. `shifts`: for each station
    the possible shifts of its matches, for the covariance. `place_sigma`: standard deviations of the registered poses,
    of a rotation in radians and a translation in baselines, if the registration determines more than these planes; the
    default is a radian and the reach, which is no constraint. `loose`: for each station matches on no plane; a common
    surface connects two stations. `sights`: of each station with a picture; common points of a plane connect stations
    along it.

    Raises RefusalError if the start puts cells behind a device, ValueError if the sequences have different lengths.
    """
    if not len(stations) == len(plane_of) == len(places):
        raise ValueError(f"{len(stations)} stations, {len(plane_of)} lists of planes, {len(places)} places")
    room = Room(start.rig, tuple(places), tuple(planes))
    patches: Sequence[Patch] = patches_of(stations, plane_of)
    reach = _reach(room, in_front(room, patches))
    # Weakly determined lens terms would compensate for wrong ties.
    known = RoomPrior.of(
        prior.holding(WEAK_TERMS), square, squareness_deg, room, place_sigma or (_FREE_ROTATION, reach)
    )
    problem, fit, known = without_wrong_ties(*fit_roughly(patches, room, known), known)
    known = replace(known, rig=prior)
    patches, free = problem.parts, known.free(seen(fit.state, problem.parts))
    problem = replace(problem, prior=known, free=free)
    for _ in range(_ROUNDS):
        levels = measured(problem, fit, _repeats(fit.state, reach))
        problem = replace(problem, variances=levels.variances(patches))
        fit = problem.minimise(fit.state, tolerance=_ROUGH)
    fit = problem.minimise(fit.state)
    tracks: tuple[Track, ...] = ()
    for _ in range(_TRACKING_ROUNDS) if sights else ():
        tracks = find_tracks(sights, _planes_of_labels(patches, plane_of), fit.state)
        problem = replace(problem, joints=tracks)
        fit = problem.minimise(fit.state)
    contacts: tuple[Contact, ...] = ()
    for share in NEAR if loose else ():
        contacts = find_contacts(loose, fit.state, [noise.match_px for noise in levels.stations], share * reach)
        problem = replace(problem, joints=(*contacts, *tracks))
        fit = problem.minimise(fit.state)

    of_waves, waves = covariance_of_waves(problem, fit, levels)
    covariance = levels.alike * (problem.covariance(fit) + of_waves)
    covariance += covariance_of_shifts(problem, fit, levels, shifts)
    for plane in range(len(fit.state.planes)):
        columns = fit.state.plane_columns(plane)
        if not free[columns].any():
            covariance[columns], covariance[:, columns] = np.nan, np.nan
    residual_px = np.full(len(stations), np.nan)
    for patch, level in zip(patches, rough_levels(patches, fit.residuals), strict=True):
        residual_px[patch.station] = np.sqrt(level)
    undetermined = undetermined_in(fit.state, covariance, reach)
    return RoomEstimate(problem, fit, covariance, levels, residual_px, undetermined, reach, waves, contacts)


def _planes_of_labels(patches: Sequence[Patch], plane_of: Sequence[Sequence[int]]) -> list[list[int]]:
    """Like `plane_of`, for the final planes of the patches; −1 for labels without cells."""
    planes = [[-1] * len(labels) for labels in plane_of]
    for patch in patches:
        planes[patch.station][int(patch.cells.plane[0])] = patch.plane
    return planes


def _reach(room: Room, patches: Sequence[Patch]) -> float:
    """Median distance of cells from their camera, in baselines."""
    return float(np.median(np.concatenate([patch.predict(room)[2][:, 0] for patch in patches])))


def _repeats(room: Room, reach: float) -> list[int]:
    """How many stations stand where each does: smooth errors are the same in all of them."""

    def same(a: Pose, b: Pose) -> bool:
        apart = float(np.linalg.norm(a.translation - b.translation))
        turned = float(np.linalg.norm(a.rotation - b.rotation)) / np.sqrt(2)
        return apart < _SAME_PLACE * reach and turned < _SAME_PLACE

    return [sum(same(place, candidate) for candidate in room.places) for place in room.places]


def undetermined_in(room: Room, covariance: Floats, reach: float) -> tuple[Undetermined, ...]:
    """The directions in which a covariance leaves places open, compared with the reach, in baselines."""
    undetermined = []
    for station in range(1, len(room.places)):
        columns = room.place_columns(station)
        for turning, limit, first in ((True, _UNDETERMINED, 0), (False, _UNDETERMINED * reach, 3)):
            block = slice(columns.start + first, columns.start + first + 3)
            variances, directions = np.linalg.eigh(covariance[block, block])
            undetermined += [
                Undetermined(station, turning, direction, float(np.sqrt(variance)))
                for variance, direction in zip(variances, directions.T, strict=True)
                if variance > limit**2
            ]
    return tuple(undetermined)
