"""Stations without planes, such as a shell on a turntable: one estimate from their common surfaces alone.

The rig is fixed to its calibration, because surfaces of arbitrary shape hardly constrain it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.estimation import Noise, NoiseLevels
from calib.finding import FindingKind
from calib.geometry import Matches, Pose, unproject
from calib.numerics import Floats
from calib.refinement import State, depths
from calib.refusal import RefusalError
from calib.rooms.estimate import NEAR, RoomEstimate, undetermined_in
from calib.rooms.factors import SMOOTH, Contact, find_contacts
from calib.rooms.priors import RigPrior, RoomPrior
from calib.rooms.room import Room
from calib.rooms.rough_fit import RoomProblem

_MATCH_PX = 1 / np.sqrt(12.0)  # sigma of plain Gray code, if matches do not state theirs
_FREE_ROTATION = 1.0  # sigma of an unconstrained rotation, in radians

TOO_FAR_APART = FindingKind(
    "too-far-apart",
    "The stations' surfaces are too far apart to be estimated together.",
    "Take stations that overlap more.",
)


def estimate_without_planes(
    loose: Sequence[Matches], places: Sequence[Pose], start: State, prior: RigPrior
) -> RoomEstimate:
    """From all matches of the stations, `places` as registered, and a calibrated rig, all in baselines.

    Raises RefusalError if no two stations share a surface.
    """
    room = Room(start.rig, tuple(places), ())
    reach = _reach(loose, room.rig)
    known = RoomPrior.of(prior, (), 0.0, room, (_FREE_ROTATION, reach))
    problem = RoomProblem((), (), known, known.free(np.zeros(0, np.bool_)))
    contacts: tuple[Contact, ...] = ()
    fit = problem.minimise(room)
    for share in NEAR:
        contacts = find_contacts(loose, fit.state, [_MATCH_PX] * len(loose), share * reach, SMOOTH)
        if not contacts:
            raise RefusalError(
                TOO_FAR_APART,
                "The stations' surfaces are too far apart to be estimated together.",
                TOO_FAR_APART.remedy,
            )
        problem = replace(problem, joints=contacts)
        fit = problem.minimise(fit.state)
    covariance = problem.covariance(fit)
    levels = NoiseLevels(tuple(Noise(_MATCH_PX, 0.0, 0.0, 1.0) for _ in loose), np.zeros(0), 1.0)
    nothing = np.full(len(loose), np.nan)
    loosely = undetermined_in(fit.state, covariance, reach)
    return RoomEstimate(problem, fit, covariance, levels, nothing, loosely, reach, np.zeros(0), contacts)


def _reach(loose: Sequence[Matches], rig: State) -> float:
    """Median distance of the points from the camera, in baselines."""
    station_depths: list[Floats] = []
    for matches in loose:
        some = matches[np.arange(0, len(matches), max(1, len(matches) // 1000))]
        station_depths.append(depths(rig, unproject(rig.camera, some.camera_px)[0], some.projector_px))
    return float(np.median(np.concatenate(station_depths)))
