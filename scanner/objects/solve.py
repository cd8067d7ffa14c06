"""Stations of a calibrated rig → a thing: the static background is removed, and the rest registered without a guess."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from calib.diagnostics import PoseErrors
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import PER_POSE, Calibration, Intrinsics, Pose
from calib.numerics import Floats
from calib.objects import (
    FEWEST_PIXELS,
    FEWEST_TO_REST,
    TOO_SMALL,
    JointEstimate,
    ObjectView,
    Registered,
    Turntable,
    confirmed,
    estimate_jointly,
    find_turntable,
    in_planes,
    register_views,
    resting_depth,
    resting_planes,
    view_of,
    within,
)
from calib.pointcloud import Cloud, build_cloud
from calib.refinement import SHARED
from calib.refusal import NoMeasurementError
from calib.registration import NOTHING_SEEN, relative_noise
from scanner.configuration import Config
from scanner.objects.contents import SolvedObject
from scanner.reconstruction import refuse_foreign, scaled
from scanner.results import Decoded, naming
from scanner.rooms import OutlierStation, Station
from scanner.stations import RigStart, find_change_of
from scanner.ui import Progress

_LOOSE_DEG, _LOOSE_OF_SIZE = 0.5, 0.01
_SIZE_GRAINS = 60.0
_NAMED = 3
_ALL_RESTS = 0.9  # share of the visible surface
_RESTS = 0.2  # share of the visible surface, before tables and walls are searched for in few stations
_TURNED_DEG = 0.3  # least rotation between stations of a thing

NOTHING_TURNED = FindingKind(
    "nothing-turned",
    "The surfaces are at the same place in all stations of a thing.",
    "Turn the thing between stations. If it is round about the axis of the turn, stick scraps of paper to it, and put "
    "it down elsewhere each time.",
)
NO_COMMON_SURFACE = FindingKind(
    "no-common-surface",
    "No two stations show the same part of a thing.",
    "Turn the thing less between stations, and let it fill the picture.",
)


def solve_object(captures: Sequence[Decoded], start: RigStart, config: Config, progress: Progress) -> SolvedObject:
    """Raises RefusalError if no two stations show one surface, nothing moved, or the calibration is of another rig."""
    calibration = scaled(start.given or start.calibration, None, config.scale)
    stations = _registered(captures, start.places, calibration, progress)
    with progress.step("Estimating"):
        joint = estimate_jointly([view for _, view in stations.members], stations.places)
        turntable = find_turntable(joint.places, joint.covariance, joint.information, joint.middle)
    if len(captures) < FEWEST_TO_REST:
        _refuse_unturned(joint.places)
    solved = _finished(stations, captures, joint, turntable, calibration)
    changed = find_change_of(start, [station.decoded for station in solved.stations])
    return replace(solved, uncertainty=start.uncertainty, findings=(*start.findings, *changed))


def place_stations(captures: Sequence[Decoded], start: RigStart, progress: Progress) -> dict[int, Pose]:
    """Where stations are, by their numbers, X_any = R X_station + t, by their surfaces under a rig in its own unit.

    Raises RefusalError if no two stations show one surface, nothing moved, or the calibration is of another rig.
    """
    return dict(_registered(captures, start.places, start.calibration, progress).registered.places)


@dataclass(frozen=True, eq=False)
class _Stations:
    """Stations with their places before these are estimated."""

    clouds: Sequence[Cloud]
    """Of all captures."""
    members: Sequence[tuple[int, ObjectView]]
    """The captures that fit together, by number."""
    registered: Registered
    outlier_stations: tuple[OutlierStation, ...]
    rests: float
    """The share of the visible surfaces that is static."""

    @property
    def places(self) -> list[Pose]:
        """Of the members."""
        return [self.registered.places[k] for k, _ in self.members]


def _registered(
    captures: Sequence[Decoded], near: Mapping[int, Pose], calibration: Calibration, progress: Progress
) -> _Stations:
    """`near`: places in baselines. Raises RefusalError."""
    clouds = [
        build_cloud(capture.matches, capture.texture, calibration)
        for capture in progress.track(captures, len(captures), "Surfaces")
    ]
    for capture, cloud in zip(captures, clouds, strict=True):
        with naming(capture, among=len(captures)):
            refuse_foreign(cloud.statistics, capture.metadata.projector_size)
    with progress.step("Separating the thing from the background"):
        views, rests = _views(clouds, captures, calibration.camera)
    if rests > _ALL_RESTS and not any(views):
        raise NoMeasurementError(
            NOTHING_TURNED,
            f"Nothing moved: all surfaces are at the same place in the {len(captures)} stations.",
            "Turn the thing between stations. If it was turned, it is round about the axis of the turn, as balls and "
            "plates are, so that its shape does not show the angle: stick scraps of paper to it, and put it down "
            "elsewhere each time.",
        )
    unit = calibration.baseline
    with progress.step("Registering"):
        registered = register_views(
            views, {k: Pose(place.rotation, unit * place.translation) for k, place in near.items()}
        )
    outlier_stations = _outlier_stations(registered, captures)
    members = [(k, view) for k, view in enumerate(views) if view is not None and k in registered.places]
    if len(members) < 2:
        raise NoMeasurementError(
            NO_COMMON_SURFACE,
            f"No two stations show the same part of a thing: {outside_text(outlier_stations)}.",
            advice_on(outlier_stations),
        )
    return _Stations(clouds, members, registered, outlier_stations, rests)


def _refuse_unturned(places: Sequence[Pose]) -> None:
    """Raise if no station is rotated relative to the first: a few stations fit together by their background."""
    turns_deg = [np.degrees(place.angle) for place in places]
    if max(turns_deg) < _TURNED_DEG:
        raise NoMeasurementError(
            NOTHING_TURNED,
            f"Nothing was turned between the {len(places)} stations, or the background outweighs the thing.",
            f"Turn the thing between stations, and take {FEWEST_TO_REST} or more of them: from fewer, only flat tables "
            "and walls can be separated from the thing. Or let the rig see only the thing.",
        )


def stations_outside(captures: Sequence[Decoded], calibration: Calibration) -> tuple[OutlierStation, ...]:
    """The stations of a thing that fit no other one, without an estimate of all."""
    clouds = [build_cloud(capture.matches, capture.texture, calibration) for capture in captures]
    return _outlier_stations(register_views(_views(clouds, captures, calibration.camera)[0]), captures)


def _outlier_stations(registered: Registered, captures: Sequence[Decoded]) -> tuple[OutlierStation, ...]:
    outliers = []
    for station in registered.left_out:
        name, matches = captures[station.station].name, len(captures[station.station].matches)
        finding = station.finding
        if finding.kind == NOTHING_SEEN and matches < FEWEST_PIXELS:
            message = f"only {matches} of its pixels measure anything"
            finding = Finding(TOO_SMALL, Severity.WARNING, message, data={"pixels": float(matches)})
        outliers.append(OutlierStation(name, finding))
    return tuple(outliers)


def outside_text(outside: Sequence[OutlierStation]) -> str:
    """Each reason with its stations, of which three are named."""
    by_reason: dict[str, list[str]] = {}
    for station in outside:
        by_reason.setdefault(station.finding.message, []).append(station.name)
    return "; ".join(f"{brief(names)}: {reason}" for reason, names in by_reason.items())


def brief(names: Sequence[str]) -> str:
    """The first three of them, and how many more there are."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def advice_on(outside: Sequence[OutlierStation]) -> str:
    """Advice if no two stations fit together."""
    if all(station.finding.kind == NOTHING_SEEN for station in outside):
        return "Turn the thing between stations: what is the same in all of them is taken for background."
    if any(station.finding.kind == TOO_SMALL for station in outside):
        return (
            "Bring the rig nearer, so that the thing fills the picture, and expose longer or spray it if it is dark or "
            "shiny."
        )
    return "Turn the thing less between stations, so that each sees half of what the one before saw."


def _views(
    clouds: Sequence[Cloud], captures: Sequence[Decoded], camera: Intrinsics
) -> tuple[list[ObjectView | None], float]:
    """Views of the thing alone, and the share of the visible surfaces that is static."""
    depths = [cloud.points[..., 2] for cloud in clouds]
    noise = [relative_noise(cloud.points, cloud.normals) for cloud in clouds]
    rest = resting_depth(depths, noise)
    same = [within(depth, rest, own) & (rest > 0) for depth, own in zip(depths, noise, strict=True)]
    measured = sum(int(np.count_nonzero(cloud.there)) for cloud in clouds)
    few = len(clouds) < FEWEST_TO_REST
    planes: list[Floats] = []
    if not few or sum(np.count_nonzero(at_rest) for at_rest in same) > _RESTS * measured:
        planes = resting_planes(
            [cloud.points[resting] for cloud, resting in zip(clouds, same, strict=True)], float(np.median(noise))
        )
    if few:
        same = [np.zeros_like(at_rest) for at_rest in same]
    views, rests = [], 0
    for cloud, capture, own, at_rest in zip(clouds, captures, noise, same, strict=True):
        resting = at_rest | in_planes(cloud.points, planes, own)
        rests += int(np.count_nonzero(resting))
        behind = np.where(at_rest, rest, np.where(resting, cloud.points[..., 2], np.float32(0)))
        views.append(view_of(cloud.points, cloud.normals, camera, behind, capture.texture))
    return views, rests / max(1, measured)


def _finished(
    registered: _Stations,
    captures: Sequence[Decoded],
    joint: JointEstimate,
    turntable: Turntable | None,
    calibration: Calibration,
) -> SolvedObject:
    members = registered.members
    places, covariance = joint.places, joint.covariance
    if turntable is not None:
        places, covariance = turntable.places, turntable.covariance
    upright = _upright(joint, turntable)
    kept = confirmed([view for _, view in members], places)
    origin: Floats = upright.inverse().translation
    about = np.eye(6)  # maps the shift of the estimate's middle to that of the thing's origin
    about[3:, :3] = -np.cross(np.eye(3), origin - joint.middle)
    stations, loose = [], []
    size = _SIZE_GRAINS * max(view.grain for _, view in members)
    for n, (k, view) in enumerate(members):
        block = about @ covariance[6 * n : 6 * n + 6, 6 * n : 6 * n + 6] @ about.T
        turning, moving = (
            np.sqrt(np.maximum(np.diag(upright.rotation @ part @ upright.rotation.T), 0.0))
            for part in (block[:3, :3], block[3:, 3:])
        )
        if np.degrees(turning).max() > _LOOSE_DEG or moving.max() > _LOOSE_OF_SIZE * size:
            loose.append(n)
        of_thing = kept[n].of_thing[..., None]
        nothing = np.float32(np.nan)
        points, normals = (np.where(of_thing, image, nothing) for image in view.image[:2])
        own = replace(registered.clouds[k], points=points, normals=normals)
        on_no_plane = np.full(view.image.depth.shape, -1, np.int32)
        place = upright @ places[n]
        stations.append(Station(k, captures[k], own, on_no_plane, place, np.degrees(turning), moving, np.nan))
    axis = None
    if turntable is not None:
        point = upright.rotation @ turntable.point + upright.translation
        axis = np.stack([point, upright.rotation @ turntable.direction])
    return SolvedObject(
        calibration,
        tuple(stations),
        joint.overlap,
        joint.residual,
        tuple(each.apart for each in kept),
        turntable,
        axis,
        registered.registered.alternatives,
        tuple(loose),
        registered.outlier_stations,
        registered.rests,
        _pose_errors(covariance, joint.middle, upright),
    )


def _pose_errors(covariance: Floats, middle: Floats, upright: Pose) -> PoseErrors:
    """From the poses' covariance about the estimate's middle, in the object's frame; the calibration is given."""
    motion = upright.adjoint @ Pose(np.eye(3), middle).adjoint
    joint = block_diag(np.zeros((SHARED, SHARED)), covariance)
    return PoseErrors.from_joint(joint, [motion] * (len(covariance) // PER_POSE))


def _upright(joint: JointEstimate, turntable: Turntable | None) -> Pose:
    """Into a frame about the thing's middle, z along the turntable's axis, or up as the first camera was held."""
    held = np.array([0.0, -1.0, 0.0])
    up: Floats = held if turntable is None else turntable.direction * (1.0 if turntable.direction @ held >= 0 else -1.0)
    towards = np.array([0.0, 0.0, 1.0]) - up[2] * up
    towards /= np.linalg.norm(towards)
    rotation = np.stack([np.cross(towards, up), towards, up])
    centre = joint.middle
    if turntable is not None:
        off = joint.middle - turntable.point
        centre = turntable.point + float(off @ up) * up
    return Pose(rotation, -rotation @ centre)
