"""A rig's calibration from its stations: from the corners that they show or, without any, from what they share.

Between stations that show no corner: what the newest determine, and which next one would help most.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Literal

from calib.finding import Finding, FindingKind, Severity, of_kinds
from calib.geometry import Calibration, Pose
from calib.refusal import RefusalError
from calib.scene import (
    BY_SCENE,
    FEWEST_STATIONS,
    NextStation,
    SceneCalibration,
    calibrate_scene,
    drift_findings,
    recalibrate_scene,
)
from scanner.configuration import Config
from scanner.quantities import relative_focal_sigmas
from scanner.reconstruction import lenses_of
from scanner.results import MEASUREMENT_GRADE, Decoded
from scanner.rooms.corner_rig import NO_STATION_WITH_CORNER, rig_from_corners
from scanner.stations import RigStart
from scanner.ui import Progress

NO_PICTURES = FindingKind(
    "stations-without-pictures",
    "Stations without a corner have no pictures by which points could be recognised.",
    "Give captures or results with their recordings instead of matches alone, or the rig's --calibration.",
    data=("captures",),
)
Moved = Literal["object", "rig"]
"""What is turned or moved between stations."""

_NEWEST = 4  # stations that are compared
_ANY = {
    "object": "turn or tip the object by 10 to 30°, each time about another axis",
    "rig": "move the rig round the scene by 10 to 30° and roll it once, with the same things in the picture",
}
# By the axis about which the scene turns and its sign, as of `NextStation`. A rig moves the other way round.
_TURNS = {
    "object": {
        (0, True): "tip the object by {:.0f}°, its top towards the camera",
        (0, False): "tip the object by {:.0f}°, its top away from the camera",
        (1, True): "turn the object by {:.0f}°, its front to the left as the camera sees it",
        (1, False): "turn the object by {:.0f}°, its front to the right as the camera sees it",
        (2, True): "tip the object sideways by {:.0f}°, clockwise as the camera sees it",
        (2, False): "tip the object sideways by {:.0f}°, anticlockwise as the camera sees it",
    },
    "rig": {
        (0, True): "raise the rig and look down on the scene by {:.0f}° more",
        (0, False): "lower the rig and look up at the scene by {:.0f}° more",
        (1, True): "go round the scene to the right by {:.0f}°",
        (1, False): "go round the scene to the left by {:.0f}°",
        (2, True): "roll the rig by {:.0f}°, its left side down",
        (2, False): "roll the rig by {:.0f}°, its right side down",
    },
}


def rig_from_stations(stations: Sequence[Decoded], config: Config, progress: Progress) -> RigStart:
    """The rig by corners, or without any by what the stations share. Raises RefusalError."""
    try:
        return rig_from_corners(stations, config, progress)
    except RefusalError as no_corner:
        if no_corner.finding.kind != NO_STATION_WITH_CORNER:
            raise
        with after_no_corner(no_corner):
            return rig_from_scene(stations, config, progress)


@contextmanager
def after_no_corner(no_corner: RefusalError) -> Iterator[None]:
    """A refusal in the block says also why there is no corner."""
    try:
        yield
    except RefusalError as refusal:
        reason = f"{no_corner.reason} Without a corner: {refusal.reason}"
        raise RefusalError(refusal.finding.kind, reason, refusal.advice, refusal.finding.data) from None


def rig_from_scene(stations: Sequence[Decoded], config: Config, progress: Progress) -> RigStart:
    """The rig by what the stations share. Raises RefusalError."""
    return start_of(calibrate_by_pictures(stations, config, progress))


def calibrate_by_pictures(
    stations: Sequence[Decoded], config: Config, progress: Progress, *, provisional: bool = False
) -> SceneCalibration:
    """What the stations determine whose pictures have points in common. Raises RefusalError.

    `provisional`: as of `calibrate_scene`.
    """
    sizes = stations[0].metadata.camera_size, stations[0].metadata.projector_size
    pictures = [(station.matches, station.texture) for station in stations if station.texture is not None]
    without = len(stations) - len(pictures)
    if without:
        message = f"{without} of {len(stations)} stations have no picture by which points could be recognised."
        raise RefusalError(NO_PICTURES, message, NO_PICTURES.remedy, {"captures": float(without)})
    with progress.step("Calibrating by what the stations share"):
        return calibrate_scene(
            pictures,
            *sizes,
            principal_point=config.principal_point(sizes[0]),
            lenses=lenses_of(config, *sizes),
            provisional=provisional,
        )


def start_of(scene: SceneCalibration) -> RigStart:
    """The rig of a calibration by what stations share."""
    places = {k: pose.inverse() for k, pose in zip(scene.stations, scene.poses, strict=True)}
    return RigStart(scene.calibration, scene.uncertainty, {}, findings=findings_on(scene), places=places)


def rig_from_placed(
    start: RigStart, stations: Mapping[int, Decoded], places: Mapping[int, Pose], config: Config, progress: Progress
) -> RigStart:
    """The rig by what stations share. Raises RefusalError.

    `stations`: by number; `places`: where they are under the start's rig and in its unit, X_any = R X_station + t.
    """
    rig = start.calibration
    numbers = [k for k, station in stations.items() if station.texture is not None]
    pictures = [(stations[k].matches, texture) for k in numbers if (texture := stations[k].texture) is not None]
    with_picture = [places[k].inverse() for k in numbers]
    with progress.step("Calibrating by all that the stations share"):
        solved = recalibrate_scene(
            rig,
            pictures,
            with_picture,
            principal_point=config.principal_point(rig.camera.size),
            lenses=lenses_of(config, *rig.sizes),
        )
    return start_of(replace(solved, stations=tuple(numbers[k] for k in solved.stations)))


def weakness_of(calibration: Calibration, findings: Sequence[Finding]) -> str | None:
    """What to say of a rig that its stations calibrate worse than measuring needs; None otherwise."""
    worst = max(relative_focal_sigmas(calibration).values(), default=0.0)
    if worst <= MEASUREMENT_GRADE or not of_kinds(findings, BY_SCENE):
        return None
    return f"the rig's focal lengths, which the stations calibrate, are only known to ± {100 * worst:.2g} %."


def findings_on(solved: SceneCalibration) -> tuple[Finding, ...]:
    """What the calibration was made from, and how sure it is; and a drift of the projector's picture."""
    sigma = solved.calibration.sigma
    devices = (sigma.camera, solved.calibration.camera), (sigma.projector, solved.calibration.projector)
    percents = [100 * own.focal_px[0] / device.focal_px[0] for own, device in devices if own.focal_px is not None]
    by_scene = Finding(
        BY_SCENE,
        Severity.NOTE,
        f"Calibrated without a corner, by {solved.points} points that {len(solved.stations)} stations share: focal "
        f"lengths ± {percents[0]:.2g} % (camera) and ± {percents[1]:.2g} % (projector).",
        data={
            "captures": float(len(solved.stations)),
            "points": float(solved.points),
            "camera_focal_percent": percents[0],
            "projector_focal_percent": percents[1],
        },
    )
    return (by_scene, *drift_findings(solved.problem.spread.drift_px))


def guide_without_corner(captures: Sequence[Decoded], config: Config, progress: Progress, moved: Moved) -> str:
    """Sentences about the stations so far, for an operator who takes a further one."""
    missing = FEWEST_STATIONS - len(captures)
    if missing > 0:
        more = "One more station calibrates" if missing == 1 else f"{missing} more stations calibrate"
        return f"{more} the rig. Next: {_ANY[moved]}."
    newest = captures[-_NEWEST:]
    try:
        scene = calibrate_by_pictures(newest, config, progress)
    except RefusalError as refusal:
        return f"The last {len(newest)} stations do not calibrate the rig yet. {refusal.reason} {refusal.advice}"
    if len(newest) - 1 not in scene.stations:
        return f"{newest[-1].name} shares too few points with those before it. Next: turn by less, 10 to 20°."
    known = 100 * max(relative_focal_sigmas(scene.calibration).values())
    sentence = f"The last {len(newest)} stations determine the focal lengths to ± {known:.2g} %."
    return f"{sentence} {_next(scene.next_station(), moved)}"


def _next(best: NextStation | None, moved: Moved) -> str:
    if best is None:
        return f"Next: {_ANY[moved]}."
    turn = _TURNS[moved][best.axis, best.turn_deg > 0].format(abs(best.turn_deg))
    percent = 100 * max(best.camera_focal, best.projector_focal)
    return f"Most would help: {turn}; then ± {percent:.2g} %."
