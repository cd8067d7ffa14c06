"""Stations and a rig to begin with → a room: registered without a guess, then one estimate of all of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics import Uncertainty, calibration_of, sigmas_of
from calib.estimation import Cells, into_cells
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, Corner, Matches, Sigmas
from calib.numerics import Floats, Ints
from calib.pointcloud import build_cloud
from calib.refinement import Knowledge
from calib.refusal import RefusalError
from calib.registration import Group, Registration, StationView, find_keypoints, register, split_planes, station_view
from calib.rooms import (
    LabelledPicture,
    RigPrior,
    RoomEstimate,
    SurfaceDisplacement,
    changed_extrinsics,
    disagreements,
    estimate_room,
    estimate_without_planes,
    vertex,
)
from scanner.configuration import Config
from scanner.reconstruction import lenses_of, scaled, shifts_of
from scanner.results import Decoded
from scanner.rooms.contents import SolvedRoom, Station
from scanner.rooms.corner_rig import ideal_matches, ideal_rig, is_estimated, state_of
from scanner.rooms.epipolar_lines import CHANGED_RIG, of_another_rig, outlier_stations_of
from scanner.rooms.upright import upright
from scanner.stations import RigStart, find_change_of
from scanner.ui import Progress

_FEWEST_ON_A_PLANE = 200
_MOST_ROUNDS = 3
_UP_OF_IMAGES = "No floor was seen, so up is the top of the cameras' images."
_SURFACES_ALONE = (
    "The planes and the dense surfaces disagree about the poses: they were estimated from the surfaces alone"
)
_MOST_ON_FACE = 0.5  # share of a face's matches that must be on one plane for the face to be that plane

NO_FLOOR = FindingKind(
    "no-floor",
    "No station saw the floor, so up is the top of the cameras' images.",
    "Let a station see the floor.",
)
BY_SURFACES = FindingKind(
    "by-surfaces",
    "The planes and the dense surfaces disagree about the poses, which were estimated from the surfaces alone.",
)
NO_COMMON_PART = FindingKind(
    "no-common-part",
    "No two stations show the same part of a room.",
    "Each station should see about a third of what the previous one saw, with more than a bare wall in it.",
)
SURFACES_APART = FindingKind(
    "surfaces-apart",
    "The surfaces of stations do not coincide, by far more than their sigmas allow.",
    "Let nothing move between the stations; scan a thing on a turntable with scan object.",
)


@dataclass(frozen=True, eq=False)
class CaptureView:
    """A capture by the rig as it was known at first: its planes, and which of them each match (N,) is on."""

    decoded: Decoded
    view: StationView
    plane: Ints


def segment_capture(capture: Decoded, calibration: Calibration) -> CaptureView:
    """A capture's planes, and the keypoints on them where it has a picture."""
    cloud = build_cloud(capture.matches, None, calibration)
    view = station_view(cloud.points, cloud.normals, calibration.camera)
    view, plane = split_planes(view, capture.matches, calibration)
    if capture.texture is not None:
        keypoints = find_keypoints(capture.texture, view.points, view.labels, view.planes, view.camera)
        view = replace(view, keypoints=keypoints)
    return CaptureView(capture, view, plane)


def solve_room(captures: Sequence[Decoded], start: RigStart, config: Config, progress: Progress) -> SolvedRoom:
    """Raises RefusalError if no two stations belong together, or if they contradict each other."""
    registered = _registered(captures, start.calibration, {}, progress)
    estimate = _estimate(registered, start, config, progress)
    turned: dict[int, Finding] = {}
    for _ in range(_MOST_ROUNDS):
        rig = _measured(estimate, captures) if is_estimated(start) else start.calibration
        more = _turned(registered, estimate)
        if not more and (not is_estimated(start) or registered.is_settled_by(rig, turned)):
            break
        # The first rig bends surfaces; with the estimated rig more stations may fit.
        turned |= more
        again = _registered(captures, rig, turned, progress)
        if not more and len(again.members) < len(registered.members):
            break
        registered = again
        start = start if start.given else replace(start, calibration=rig)
        estimate = _estimate(registered, start, config, progress)
    estimate, by_surfaces = _checked_against_surfaces(registered, estimate, start, progress)
    return _finished(registered, estimate, start, config, by_surfaces)


def _measured(estimate: RoomEstimate, captures: Sequence[Decoded]) -> Calibration:
    metadata = captures[0].metadata
    return calibration_of(estimate.room.rig, metadata.camera_size, metadata.projector_size, Sigmas())


@dataclass(frozen=True, eq=False)
class _Registered:
    """All captures by one rig, which of them another one made, and which belong together."""

    views: Sequence[CaptureView]
    changed: Mapping[int, Finding]
    registration: Registration

    @property
    def members(self) -> list[CaptureView]:
        """Of the largest group."""
        return [self.views[k] for group in self.registration.groups[:1] for k in group.stations]

    def is_settled_by(self, measured: Calibration, turned: Mapping[int, Finding]) -> bool:
        """Whether all captures of the rig belong together, also with the estimated rig."""
        changed = of_another_rig([view.decoded.matches for view in self.views], measured)
        as_before = changed.keys() | turned.keys() == self.changed.keys()
        return as_before and len(self.members) + len(self.changed) == len(self.views)


def _registered(
    captures: Sequence[Decoded], rig: Calibration, turned: Mapping[int, Finding], progress: Progress
) -> _Registered:
    """Register the captures without those known to be `turned`. Raises RefusalError if no two belong together."""
    views = [segment_capture(capture, rig) for capture in progress.track(captures, len(captures), "Surfaces")]
    changed = {**turned, **of_another_rig([capture.matches for capture in captures], rig)}
    with progress.step("Registering"):
        registration = register([view.view for view in views], changed)
    if not registration.groups:
        raise RefusalError(
            NO_COMMON_PART,
            "No two stations show the same part of a room: " + _reasons(captures, registration),
            NO_COMMON_PART.remedy,
        )
    return _Registered(views, changed, registration)


def _turned(registered: _Registered, estimate: RoomEstimate) -> dict[int, Finding]:
    """Captures with a changed rig, by the planes that they saw; with the size of the change."""
    stations = registered.registration.groups[0].stations
    return {
        stations[change.station]: Finding(
            CHANGED_RIG,
            Severity.WARNING,
            f"by the planes that it saw, its projector was rotated by {change.turn_deg:.2g}° against the camera, which "
            f"moves its light by {change.px:.2g} px",
            data={"turn_deg": change.turn_deg, "off_px": change.px},
        )
        for change in changed_extrinsics(estimate)
    }


def _reasons(captures: Sequence[Decoded], registration: Registration) -> str:
    return "; ".join(f"{captures[left.station].name}: {left.finding.message}" for left in registration.left_out) + "."


def _estimate(registered: _Registered, start: RigStart, config: Config, progress: Progress) -> RoomEstimate:
    with progress.step("Estimating"):
        return _estimated(registered.members, registered.registration.groups[0], start, config)


def _checked_against_surfaces(
    registered: _Registered, estimate: RoomEstimate, start: RigStart, progress: Progress
) -> tuple[RoomEstimate, bool]:
    """The estimate, or one from the surfaces alone if the stations' surfaces contradict it, and whether it is that.

    Raises RefusalError if the surfaces contradict each other as well.
    """
    members = registered.members
    matches = [ideal_matches(member.decoded.matches, start) for member in members]
    with progress.step("Asking the surfaces"):
        if not disagreements(matches, estimate):
            return estimate, False
        known = RigPrior.exactly(estimate.room.rig)
        by_surfaces = estimate_without_planes(matches, estimate.room.places, estimate.room.rig, known)
        apart = disagreements(matches, by_surfaces)
    if apart:
        names = sorted({members[k].decoded.name for pair in apart for k in (pair.first, pair.second)})
        worst = max(apart, key=lambda pair: max(pair.sigmas, pair.apart))
        raise RefusalError(
            SURFACES_APART,
            f"The surfaces of {', '.join(names)} do not coincide: {_apart(worst)}.",
            "Part of the scene moved between the stations: scan a thing on a turntable with "
            "scan object, or let nothing move.",
        )
    return by_surfaces, True


def _apart(worst: SurfaceDisplacement) -> str:
    if worst.sigmas > 1:
        return f"they would need {worst.turn_deg:.2g}° more of rotation, far beyond what the matches' sigmas allow"
    return f"{worst.apart:.0%} of the surface that two of them saw is at different places"


def _estimated(members: Sequence[CaptureView], group: Group, start: RigStart, config: Config) -> RoomEstimate:
    state = state_of(start.calibration if is_estimated(start) else ideal_rig(start.calibration))
    metadata = members[0].decoded.metadata
    if start.corners:
        point = config.principal_point(metadata.camera_size)
        squareness_deg = config.corner.expected_squareness_deg
        sizes = metadata.camera_size, metadata.projector_size
        lenses = lenses_of(config, *sizes)
        knowledge = Knowledge(*sizes, point.px, point.sigma_px, squareness_deg, lenses=lenses)
        prior = RigPrior.from_knowledge(knowledge, state)
    elif start.uncertainty is not None:
        prior = RigPrior.from_calibration(state, start.uncertainty.covariance)
    else:
        prior = RigPrior.exactly(state)
    matches = [ideal_matches(member.decoded.matches, start) for member in members]
    loose = [own[member.plane < 0] for own, member in zip(matches, members, strict=True)]
    cells = [_cells(own, member.plane) for own, member in zip(matches, members, strict=True)]
    if not any(len(cell) for cell in cells):
        return estimate_without_planes(loose, group.places, state, prior)
    return estimate_room(
        cells,
        group.plane_of,
        group.places,
        group.planes,
        state,
        prior,
        square=_square_pairs(members, group, start),
        squareness_deg=config.corner.expected_squareness_deg,
        shifts=[shifts_of(member.decoded) for member in members],
        loose=loose,
        sights=[_sight(member) for member in members] if is_estimated(start) else (),
    )


def _sight(view: CaptureView) -> LabelledPicture | None:
    picture = view.decoded.texture
    return None if picture is None else LabelledPicture.of(picture, view.view.labels)


def _cells(matches: Matches, plane: Ints) -> Cells:
    count = np.bincount(plane[plane >= 0])
    labels = np.flatnonzero(count >= _FEWEST_ON_A_PLANE).tolist()
    if not labels:
        pixels, nothing = np.zeros((0, 2)), np.zeros(0)
        return Cells(pixels, pixels, np.zeros(0, np.int32), nothing, nothing, np.nan, 0.0)
    return into_cells(matches, labels, plane)


def _square_pairs(members: Sequence[CaptureView], group: Group, start: RigStart) -> list[tuple[int, int]]:
    """The faces of the corners that the rig was calibrated from, as pairs of the room's planes."""
    pairs = []
    for number, (station, seen) in enumerate(zip(group.stations, members, strict=True)):
        faces = _faces(seen, group.plane_of[number], start.corners.get(station))
        pairs += [
            (a, b) for a, b in ((faces[0], faces[1]), (faces[1], faces[2]), (faces[0], faces[2])) if -1 < a != b > -1
        ]
    return pairs


def _faces(view: CaptureView, plane_of: Sequence[int], corner: Decoded | None) -> tuple[int, int, int]:
    """Which planes of the room the faces of a station's corner are; −1 where none is."""
    if corner is None:
        return -1, -1, -1
    faces = []
    for face in range(3):
        on_face = view.plane[corner.matches.labels == face]
        count = np.bincount(on_face[on_face >= 0], minlength=1)
        most = int(count.argmax())
        faces.append(plane_of[most] if plane_of and count[most] > _MOST_ON_FACE * len(on_face) else -1)
    return faces[0], faces[1], faces[2]


def _finished(
    registered: _Registered, estimate: RoomEstimate, start: RigStart, config: Config, by_surfaces: bool
) -> SolvedRoom:
    """Apply the scale, turn the room upright, and make the clouds with the estimated rig."""
    registration, members = registered.registration, registered.members
    group = registration.groups[0]
    if by_surfaces:
        group = replace(group, planes=(), plane_of=tuple((-1,) * len(of_station) for of_station in group.plane_of))
    metadata = members[0].decoded.metadata
    sigma = sigmas_of(estimate.room.rig, estimate.rig_covariance)
    own = calibration_of(estimate.room.rig, metadata.camera_size, metadata.projector_size, sigma)
    known = start.given if start.given and not is_estimated(start) else _in_unit_of(start.given, own)
    calibration = scaled(known, _corner(members, group, estimate, start), config.scale)
    factor = calibration.baseline
    areas = areas_of(members, group, len(estimate.room.planes))
    turn, floor = upright(estimate.room.places, estimate.room.planes, areas)
    stations = tuple(
        Station(
            group.stations[i],
            member.decoded,
            build_cloud(member.decoded.matches, member.decoded.texture, calibration),
            np.array([*group.plane_of[i], -1], np.int32)[member.view.labels],
            (turn @ estimate.room.places[i]).scaled(factor),
            *_sigmas(estimate, i, turn.rotation, factor),
            float(estimate.residual_px[i]),
        )
        for i, member in enumerate(members)
    )
    match_px = float(np.nanmedian([noise.match_px for noise in estimate.levels.stations]))
    captures = [view.decoded for view in registered.views]
    findings = [*start.findings, *find_change_of(start, [station.decoded for station in stations])]
    findings += [Finding(NO_FLOOR, Severity.NOTE, _UP_OF_IMAGES)] if floor is None else []
    findings += [Finding(BY_SURFACES, Severity.NOTE, _SURFACES_ALONE)] if by_surfaces else []
    return SolvedRoom(
        calibration,
        Uncertainty(estimate.room.rig, estimate.rig_covariance, None, match_px) if is_estimated(start) else None,
        stations,
        tuple(plane.moved(turn, factor) for plane in estimate.room.planes),
        estimate,
        turn,
        factor,
        group,
        registration.pairs,
        tuple(capture.name for capture in captures),
        outlier_stations_of(registration, captures, calibration, stations),
        tuple(findings),
        floor,
        factor**2 * areas,
    )


def _in_unit_of(given: Calibration | None, own: Calibration) -> Calibration:
    """An estimate in baselines with the length of the baseline that a given calibration has."""
    if given is None:
        return own
    sigma = replace(own.sigma, known_baseline=given.sigma.known_baseline)
    return replace(own.scaled(given.baseline, given.unit), sigma=sigma)


def areas_of(members: Sequence[CaptureView], group: Group, planes: int) -> Floats:
    """How much was seen of each plane of the room, (P,), in squared baselines, slant apart."""
    areas = np.zeros(planes)
    for seen, plane_of in zip(members, group.plane_of, strict=True):
        labels = seen.view.labels
        there = labels >= 0
        own = np.bincount(labels[there], seen.view.points[..., 2][there] ** 2, minlength=len(plane_of))
        for label, plane in enumerate(plane_of):
            if plane >= 0:
                areas[plane] += own[label] / float(np.prod(seen.view.camera.focal_px))
    return areas


def _corner(members: Sequence[CaptureView], group: Group, estimate: RoomEstimate, start: RigStart) -> Corner | None:
    """The corner before the last station that shows one, in its camera's frame; only its vertex counts."""
    for number in reversed(range(len(members))):
        faces = _faces(members[number], group.plane_of[number], start.corners.get(group.stations[number]))
        if min(faces) >= 0 and len(set(faces)) == 3:
            place = estimate.room.places[number]
            return Corner(place.undo(vertex(estimate, *faces).position), np.eye(3))
    return None


def _sigmas(estimate: RoomEstimate, station: int, turn: Floats, factor: float) -> tuple[Floats, Floats]:
    """Sigmas in degrees about the room's axes, and in its unit along them, (3,) each."""
    covariance = estimate.place_covariance(station)
    turning, moving = (np.diag(turn @ block @ turn.T) for block in (covariance[:3, :3], covariance[3:, 3:]))
    return np.degrees(np.sqrt(turning)), factor * np.sqrt(moving)
