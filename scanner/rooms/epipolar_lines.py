"""Whether captures were made by one rig, and why a capture is no station of a room: its rig changed, it is of another
room, or it does not overlap.

Three criteria decide. The matches of an unchanged rig lie on the epipolar lines of the stations' rig, whatever they
show. Surfaces are a weaker criterion: a changed rig bends them, but perhaps not beyond other errors, and they may then
be taken for a part of the room; those that fit only where they violate free space are of another room. And after the
stations saw the whole room, a capture without overlap is of another one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, Matches, intersect_rays
from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints
from calib.registration import ANOTHER_ROOM, NO_OVERLAP, Registration
from scanner.results import Decoded
from scanner.rooms.contents import OutlierStation, Station

_TILE = 16  # pixels
_FEWEST_IN_A_TILE = 30
_FAR_OFF = 3.0  # sigmas of the median tile
_LEAST_PX = 0.03  # smooth errors of a decoder, and slight deformation of a carried rig
_DEVIATIONS_OF_MEDIAN = 1.2533 * SIGMA_PER_MEDIAN  # standard error of a median · √N, in median deviations from it

CHANGED_RIG = FindingKind(
    "changed-rig",
    "A station is left out: another rig, or a changed one, made it.",
    "Camera, projector, zoom and focus have to stay as they are between stations: take it again.",
    ("off_px", "turn_deg"),
)
_SAMPLE = 20_000  # points per station
_OF_ITS_VIEW = 0.5  # share of a view; the rest would be in view of others from any pose
_ALL_ROUND = "the stations saw the whole room"


@dataclass(frozen=True, eq=False)
class LineOffsets:
    """By how much a capture's matches are off the epipolar lines of a rig, in projector px, as medians over tiles of
    the camera's picture (T,) with their standard errors.
    """

    median_px: Floats
    error_px: Floats

    @property
    def usual_px(self) -> float:
        """Root mean square over the tiles; infinite if there are none."""
        return float(np.sqrt(np.mean(self.median_px**2))) if len(self.median_px) else np.inf

    def deviation_px(self, usual_px: float) -> float | None:
        """By how much the capture is off, if by more than noise and `usual_px`, as the rig's own captures are."""
        if len(self.median_px) == 0:
            return None
        off = np.abs(self.median_px)
        return float(np.median(off)) if np.median(off / np.hypot(self.error_px, usual_px)) > _FAR_OFF else None


def line_offsets(matches: Matches, calibration: Calibration) -> LineOffsets:
    """Of one capture."""
    met = intersect_rays(matches.camera_px, matches.projector_px, calibration)
    camera_px, off = matches.camera_px[met.in_front], met.residual_px[met.in_front]
    column, row = np.rint(camera_px).astype(np.int64).T // _TILE
    tile = row * (calibration.camera.width // _TILE + 1) + column
    _, own, count = np.unique(tile, return_inverse=True, return_counts=True)
    median = _medians(off, own, count)
    error = _DEVIATIONS_OF_MEDIAN * _medians(np.abs(off - median[own]), own, count) / np.sqrt(count)
    enough = count >= _FEWEST_IN_A_TILE
    return LineOffsets(median[enough], error[enough])


def usual_px(offsets: Sequence[LineOffsets]) -> float:
    """Root mean square over the tiles; infinite without any."""
    return max(_LEAST_PX, sorted(offset.usual_px for offset in offsets)[(len(offsets) - 1) // 2])


def of_another_rig(captures: Sequence[Matches], calibration: Calibration) -> dict[int, Finding]:
    """Which captures another rig made than most of them, by number, and what shows it.

    `calibration`: of the rig, as most of the captures, or the corners that some of them show, have it.
    """
    offsets = [line_offsets(capture, calibration) for capture in captures]
    usual = usual_px(offsets)
    far = {k: offset.deviation_px(usual) for k, offset in enumerate(offsets)}
    return {
        k: Finding(
            CHANGED_RIG,
            Severity.WARNING,
            f"its matches are {px:.2g} projector px off the epipolar lines of the others' rig",
            data={"off_px": px},
        )
        for k, px in far.items()
        if px is not None
    }


def _medians(values: Floats, group: Ints, count: Ints) -> Floats:
    """Of each group 0 … G − 1 of the values (N,), (G,); `count` (G,) are their sizes. Of two middle ones the upper."""
    order = np.lexsort((values, group))
    medians: Floats = values[order][np.cumsum(count) - count + count // 2]
    return medians


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
