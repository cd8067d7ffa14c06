"""Synthetic rigs with ground truth: boards and corners of one rig, a room of stations, and disturbed starts."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from calib.boards import Board, BoardCalibration, calibrate_boards, rig_uncertainty
from calib.diagnostics import SystematicErrors
from calib.estimation import Cells, into_cells
from calib.geometry import Calibration, Intrinsics, Matches, Plane
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR, ROTATION, SHARED, Knowledge, State
from calib.rooms import Room
from calib.self_calibration import KnownCalibration, PrincipalPoint, SelfCalibration, self_calibrate_jointly
from calib.synthetic import SyntheticRoom, random_boards, random_captures
from tests.support.board_captures import views_of
from tests.support.states import device_of

# The paper's camera at a quarter of its size: clouds and reports cost by the pixel, however few matches are.
SMALL_CAMERA = Intrinsics(612, 512, (447.775, 447.775), (313.7, 263.2))


@dataclass(frozen=True)
class Before:
    """`boards` with their estimate, `known`; the matches of the `corner`; `truth` of the rig, in metres."""

    truth: Calibration
    boards: BoardCalibration
    known: KnownCalibration
    corner: Matches

    @property
    def guess(self) -> PrincipalPoint:
        camera = self.truth.camera
        return PrincipalPoint(((camera.width - 1) / 2, (camera.height - 1) / 2), 0.03 * camera.width)

    def joint(self) -> SelfCalibration:
        sizes = self.truth.camera.size, self.truth.projector.size
        (found,) = self_calibrate_jointly([self.corner], *sizes, principal_point=self.guess, known=self.known)
        return found


@cache
def before(seed: int, **changes: Any) -> Before:
    rng = np.random.default_rng(seed)
    rig, found, known = from_boards(rng, views=4, matches=2000, **changes)
    return Before(rig, found, known, corner_before(rng, rig))


def from_boards(
    rng: np.random.Generator, *, views: int, matches: int, **changes: Any
) -> tuple[Calibration, BoardCalibration, KnownCalibration]:
    """A synthetic rig, and its calibration from flat boards."""
    boards = random_boards(rng, views=views, matches=matches, bend=0.0, **changes)
    rig = boards.calibration
    sizes = rig.camera.size, rig.projector.size
    found = calibrate_boards(views_of(boards), *sizes, Board(boards.reach, 2, "m"))
    return rig, found, KnownCalibration(found.calibration, rig_uncertainty(found.estimate, sizes))


def corner_before(rng: np.random.Generator, rig: Calibration, zoom: float = 1.0) -> Matches:
    """A capture of a corner by the rig, with its projector's focal length multiplied by `zoom`."""
    focal = zoom * rig.projector.focal_px[0]
    (capture,) = random_captures(
        rng,
        1,
        rig=rig,
        camera=rig.camera,
        projector=replace(rig.projector, focal_px=(focal, focal)),
        count=20_000,
        distance=(1.0, 2.0),
        walls_off_deg=0.3,
    )
    return capture.matches


def errors_of(known: KnownCalibration) -> SystematicErrors:
    calibration = known.calibration
    sigma = (calibration.sigma.known_baseline or 0.0) / calibration.baseline
    return SystematicErrors.of(calibration, known.uncertainty, sigma)


def intrinsics_and_length(calibration: Calibration) -> Floats:
    """Focal length and principal point of both devices, and the baseline, (7,)."""
    devices = (calibration.camera, calibration.projector)
    return np.array([*(x for d in devices for x in (d.focal_px[0], *d.principal_point_px)), calibration.baseline])


def sigmas(calibration: Calibration) -> Floats:
    """Sigmas of these parameters, (7,)."""
    own = calibration.sigma
    devices = (own.camera, own.projector)
    return np.array([*(x for d in devices for x in (d.focal_px[0], *d.principal_point_px)), own.known_baseline])


def true_room(made: SyntheticRoom) -> tuple[Room, list[dict[int, int]]]:
    """The room in baselines and the first camera's frame; planes in the order of the synthetic room's.

    Also, for each station, the room's plane of each label of its matches.
    """
    rig, first = made.calibration, made.stations[0].pose
    unit = rig.baseline
    places = tuple((first.inverse() @ station.pose).scaled(1 / unit) for station in made.stations)
    labels = [np.unique(station.matches.labels[station.matches.labels >= 0]) for station in made.stations]
    seen = np.unique(np.concatenate(labels))
    planes = tuple(
        Plane(first.rotation.T @ normal, float(offset - normal @ first.translation) / unit)
        for normal, offset in zip(made.normals[seen], made.offsets[seen], strict=True)
    )
    state = State(device_of(rig.camera), device_of(rig.projector), rig.pose.scaled(1 / unit))
    number = {int(label): i for i, label in enumerate(seen)}
    return Room(state, places, planes), [{int(label): number[int(label)] for label in each} for each in labels]


def cells_of(made: SyntheticRoom, numbers: list[dict[int, int]]) -> tuple[list[Cells], list[tuple[int, ...]]]:
    """Cells by local labels 0, 1, …, and the room's plane of each."""
    stations = []
    for station, number in zip(made.stations, numbers, strict=True):
        local = np.full(max(number) + 2, -1, np.int32)
        local[list(number)] = np.arange(len(number))
        stations.append(into_cells(station.matches, range(len(number)), local[station.matches.labels]))
    return stations, [tuple(number.values()) for number in numbers]


def disturbed(rng: np.random.Generator, room: Room, made: SyntheticRoom) -> Room:
    """Focal lengths off by 1 %, positions by 30 mm and 0.5°, planes likewise."""
    step = np.zeros(room.size)
    camera, projector = CAMERA.start, PROJECTOR.start
    step[[camera, projector]] = rng.normal(0, 0.01, 2)
    step[[camera + 1, camera + 2, projector + 1, projector + 2]] = rng.normal(0, 5.0, 4)
    step[ROTATION.start : SHARED] = rng.normal(0, 0.003, 5)
    unit = made.calibration.baseline
    shift, turn = 0.03 / unit, np.radians(0.5)
    for station in range(1, len(room.places)):
        step[room.place_columns(station)] = rng.normal(size=6) * np.repeat([turn, shift], 3)
    for plane in range(len(room.planes)):
        step[room.plane_columns(plane)] = rng.normal(size=3) * [turn, turn, shift]
    return room.moved(step)


def knowledge_of(made: SyntheticRoom) -> Knowledge:
    """Image sizes, the camera's principal point in the middle with a sigma of 50 px, and ordinary lenses."""
    camera, projector = made.calibration.camera.size, made.calibration.projector.size
    return Knowledge(camera, projector, ((camera.width - 1) / 2, (camera.height - 1) / 2), 50.0, 0.3)
