"""Why a capture is no station of a room: its rig changed, it is of another room, or it does not overlap.

Three criteria decide. The matches of an unchanged rig lie on the epipolar lines of the stations' rig. Surfaces that fit
only where they violate free space are of another room. And after the stations saw the whole room, a capture without
overlap is of another one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.finding import Finding, Severity
from calib.geometry import Calibration
from calib.numerics import Floats
from calib.registration import ANOTHER_ROOM, NO_OVERLAP, Registration
from scanner.results import Decoded
from scanner.rooms.contents import OutlierStation, Station
from scanner.rooms.epipolar_lines import CHANGED_RIG

_SAMPLE = 20_000  # points per station
_OF_ITS_VIEW = 0.5  # share of a view; the rest would be in view of others from any pose
_ALL_ROUND = "the stations saw the whole room"


def outlier_stations_of(
    registration: Registration, captures: Sequence[Decoded], calibration: Calibration, stations: Sequence[Station]
) -> tuple[OutlierStation, ...]:
    """All captures outside the largest group, with reasons.

    `calibration`: the rig as estimated by this group; `stations`: its stations, in the room's frame, z up.
    """
    alone = {outlier.station: outlier for outlier in registration.left_out}
    beside = {k: group.stations for group in registration.groups[1:] for k in group.stations}
    if not alone and not beside:
        return ()
    unseen_deg = widest_unseen_deg(stations)
    outliers = []
    for k in (*alone, *beside):
        capture = captures[k]
        all_round = unseen_deg < _OF_ITS_VIEW * _view_deg(capture, calibration)
        if k in alone:
            outliers.append(_left_out(capture.name, alone[k].finding, all_round))
        else:
            together = ", ".join(captures[neighbour].name for neighbour in beside[k])
            outliers.append(_of_another_group(capture.name, together, all_round))
    return tuple(outliers)


def widest_unseen_deg(stations: Sequence[Station]) -> float:
    """The widest sector, seen from the middle of all stations, in which none of them saw anything."""
    middle = np.mean([station.place.translation[:2] for station in stations], axis=0)
    ahead = np.concatenate([_some_points(station) for station in stations]) - middle
    angles = np.sort(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return float(np.degrees(np.max(np.diff(np.append(angles, angles[0] + 2 * np.pi)))))


def _left_out(name: str, finding: Finding, all_round: bool) -> OutlierStation:
    if finding.kind == CHANGED_RIG:
        return OutlierStation(name, replace(finding, message=f"its rig was changed: {finding.message}"))
    if finding.kind == NO_OVERLAP and all_round:
        clause = f"it shows another room: {_ALL_ROUND}, and hardly anything that it shows"
        return OutlierStation(name, Finding(ANOTHER_ROOM, Severity.WARNING, clause))
    return OutlierStation(name, finding)


def _of_another_group(name: str, together: str, all_round: bool) -> OutlierStation:
    if all_round:
        clause = f"it is of another room, with {together}: {_ALL_ROUND}, but not this"
        return OutlierStation(name, Finding(ANOTHER_ROOM, Severity.WARNING, clause))
    clause = f"it is of another part, or of another room, with {together}: no common surface connects it"
    return OutlierStation(name, Finding(NO_OVERLAP, Severity.WARNING, clause))


def _some_points(station: Station) -> Floats:
    """(M, 2) in the room's frame, as from above."""
    there = np.flatnonzero(station.cloud.there)
    chosen = there[:: max(1, len(there) // _SAMPLE)]
    return station.to_room(station.cloud.points.reshape(-1, 3)[chosen].astype(np.float64))[:, :2]


def _view_deg(capture: Decoded, calibration: Calibration) -> float:
    """How wide a capture's view is across."""
    columns = capture.matches.camera_px[:, 0]
    if len(columns) == 0:
        return 0.0
    row = calibration.camera.principal_point_px[1]
    rays = calibration.camera.unproject(np.array([[columns.min(), row], [columns.max(), row]], np.float64))
    left, right = np.arctan2(rays[:, 0], rays[:, 2])
    return float(np.degrees(right - left))
