"""A rig's calibration from stations that show a corner, accurate enough to register all of them, or held as it was
given.

Each corner calibrates the rig by itself. The estimates are combined as Gaussians, without outliers. If corners
contradict each other, because the rig changed or one is wrong, those are used whose epipolar lines fit most stations.
The room's estimate uses the same matches again, and takes only its start from here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics import Uncertainty, calibration_of
from calib.finding import FindingKind
from calib.geometry import Calibration, Intrinsics, Matches, Sigmas
from calib.numerics import Bools, Floats, inverse_of
from calib.refinement import SHARED, State, device_of
from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.reconstruction import label, solve
from scanner.results import Decoded
from scanner.rooms.epipolar_lines import line_offsets, usual_px
from scanner.stations import RigStart
from scanner.ui import Progress

# Sigmas of a single corner assume a small deviation of the walls from square; in real rooms they are slightly too
# small.
_CONTRADICTS = 5.0
_SIGMAS_OF_CORNER = 2.0
_FAR = _CONTRADICTS * _SIGMAS_OF_CORNER
_HELD = 1e-12

NO_STATION_WITH_CORNER = FindingKind(
    "no-station-with-corner",
    "No station of a room shows a corner from which the rig can be calibrated.",
    "Let one station look into a corner of the room, as scan check advises, or give the rig's --calibration.",
)


@dataclass(frozen=True, eq=False)
class SeenCorner:
    """A capture with its faces labelled, and the rig as they alone have it."""

    labelled: Decoded
    uncertainty: Uncertainty


def corner_in(capture: Decoded, config: Config) -> SeenCorner:
    """Raises RefusalError if the capture shows no corner that calibrates the rig."""
    (labelled,) = label([capture], [capture], config)
    (solution,) = solve([labelled], config)
    if solution.uncertainty is None:
        raise InputError("'method: paper' calibrates from one capture: use 'method: refined' for a room")
    return SeenCorner(labelled, solution.uncertainty)


def rig_from_corners(stations: Sequence[Decoded], config: Config, progress: Progress) -> RigStart:
    """Raises RefusalError if no station shows a corner that calibrates the rig."""
    corners: dict[int, SeenCorner] = {}
    refusals: list[str] = []
    for number, capture in enumerate(progress.track(stations, len(stations), "Looking for corners")):
        try:
            corners[number] = corner_in(capture, config)
        except RefusalError as refusal:
            refusals.append(f"{capture.name}: {refusal.reason}")
    if not corners:
        raise RefusalError(
            NO_STATION_WITH_CORNER,
            "No station shows a corner from which the rig can be calibrated. " + " ".join(refusals[:3]),
            NO_STATION_WITH_CORNER.remedy,
        )
    return rig_of(corners, stations)


def rig_of(corners: Mapping[int, SeenCorner], stations: Sequence[Decoded]) -> RigStart:
    """What corners, by the numbers of their stations, say together; at least one."""
    estimates = {k: corner.uncertainty for k, corner in corners.items()}
    kept, rig, covariance = _of_most_stations(estimates, stations)
    calibration = _calibration(rig, stations)
    match_px = float(np.median([corners[k].uncertainty.match_px for k in kept]))
    uncertainty = Uncertainty(rig, covariance, None, match_px)
    return RigStart(calibration, uncertainty, {k: corners[k].labelled for k in kept})


def _of_most_stations(corners: dict[int, Uncertainty], stations: Sequence[Decoded]) -> tuple[list[int], State, Floats]:
    """As `_together`, of the corners that agree with each other and explain most stations."""
    agreeing = {frozenset(j for j in corners if _apart(corners[k], corners[j]) < _FAR) for k in corners}
    candidates = [
        _together({k: corners[k] for k in group}) for group in sorted(agreeing, key=lambda group: sorted(group))
    ]
    if len(candidates) == 1:
        return candidates[0]
    rigs = [_calibration(rig, stations) for _, rig, _ in candidates]
    offsets = [[line_offsets(station.matches, rig) for station in stations] for rig in rigs]
    usual = min(usual_px(of_rig) for of_rig in offsets)
    on_lines = [sum(offset.deviation_px(usual) is None for offset in of_rig) for of_rig in offsets]
    best = max(range(len(candidates)), key=lambda n: (on_lines[n], len(candidates[n][0])))
    return candidates[best]


def _calibration(rig: State, stations: Sequence[Decoded]) -> Calibration:
    metadata = stations[0].metadata
    return calibration_of(rig, metadata.camera_size, metadata.projector_size, Sigmas())


def _together(corners: dict[int, Uncertainty]) -> tuple[list[int], State, Floats]:
    """Which corners agree, their common rig, and its covariance (21, 21)."""
    kept = list(corners)
    while True:
        rig, covariance = _combined([corners[k] for k in kept])
        off = {k: _distance(corners[k], rig) for k in kept}
        worst = max(kept, key=lambda k: off[k])
        if len(kept) < 3 or off[worst] < _FAR:
            return kept, rig, covariance
        kept.remove(worst)


def _combined(corners: Sequence[Uncertainty]) -> tuple[State, Floats]:
    """The product of Gaussians, about the first one's rig."""
    first = corners[0].rig
    precision, pull = np.zeros((SHARED, SHARED)), np.zeros(SHARED)
    free = _observed(corners[0])
    for corner in corners:
        own = np.zeros_like(precision)
        own[np.ix_(free, free)] = inverse_of(corner.covariance[np.ix_(free, free)])
        precision += own
        pull += own @ first.step_to(corner.rig)
    covariance, step = np.zeros_like(precision), np.zeros(SHARED)
    covariance[np.ix_(free, free)] = inverse_of(precision[np.ix_(free, free)])
    step[free] = covariance[np.ix_(free, free)] @ pull[free]
    return first.moved(step), covariance


def _distance(corner: Uncertainty, rig: State) -> float:
    """Of a corner's rig from another, in its own sigmas."""
    return _in_sigmas(corner.rig.step_to(rig), corner.covariance, _observed(corner))


def _apart(first: Uncertainty, second: Uncertainty) -> float:
    """Of two corners' rigs, in the sigmas of their difference."""
    return _in_sigmas(
        first.rig.step_to(second.rig), first.covariance + second.covariance, _observed(first) & _observed(second)
    )


def _in_sigmas(step: Floats, covariance: Floats, free: Bools) -> float:
    """Root mean square of a step (size,), of its `free` columns."""
    inverse = inverse_of(covariance[np.ix_(free, free)])
    return float(np.sqrt(step[free] @ inverse @ step[free] / np.count_nonzero(free)))


def _observed(corner: Uncertainty) -> Bools:
    """The columns that a corner determines, (21,)."""
    return np.diag(corner.covariance) > _HELD**2


def state_of(calibration: Calibration) -> State:
    """The model's parameters of a calibration in baselines."""
    camera, projector = (
        device_of(replace(device, focal_px=(float(np.mean(device.focal_px)),) * 2))
        for device in (calibration.camera, calibration.projector)
    )
    return State(camera, projector, calibration.pose.in_baselines)


def is_estimated(start: RigStart) -> bool:
    """Whether the rig is estimated together with the room, or held as it was given, without a covariance."""
    return bool(start.corners) or start.uncertainty is not None


def ideal_rig(calibration: Calibration) -> Calibration:
    """The same rig with devices that have one focal length each and no distortion."""
    camera, projector = (
        Intrinsics(device.width, device.height, (float(np.mean(device.focal_px)),) * 2, device.principal_point_px)
        for device in (calibration.camera, calibration.projector)
    )
    return replace(calibration, camera=camera, projector=projector)


def ideal_matches(matches: Matches, start: RigStart) -> Matches:
    """The matches of an ideal rig if the rig is fixed: the distortion of its lenses is removed."""
    if is_estimated(start):
        return matches
    given, ideal = start.calibration, ideal_rig(start.calibration)
    camera_px = ideal.camera.project(given.camera.unproject(matches.camera_px.astype(np.float64)))
    projector_px = ideal.projector.project(given.projector.unproject(matches.projector_px.astype(np.float64)))
    beyond = ~np.isfinite(np.hstack([camera_px, projector_px])).all(axis=1)
    camera_px[beyond], projector_px[beyond] = matches.camera_px[beyond], matches.projector_px[beyond]
    return Matches(camera_px, projector_px, None, matches.sigma_px)
