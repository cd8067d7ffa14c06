"""Ground truth of a synthetic room, and disturbed starts."""

import numpy as np

from calib.geometry import Plane
from calib.refinement import CAMERA, PROJECTOR, ROTATION, SHARED, Cells, Knowledge, State, into_cells
from calib.rooms import Room
from calib.synthetic import SyntheticRoom
from tests.support.states import device_of


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
