"""Poses in files: `room.yaml`, of stations, planes and their sigmas; `poses.yaml`, of the captures of a corner;
`network.yaml`, of the devices of a network, with their intrinsics.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from calib.geometry import Intrinsics, Pose
from scanner.errors import InputError
from scanner.io.calibration_file import DeviceEntry
from scanner.io.validation import Entry, Number, validate
from scanner.io.yaml_text import flow_yaml, read_yaml

_Cosine = Annotated[Number, Field(ge=-2, le=2)]
_Length = Annotated[Number, Field(ge=-1e12, le=1e12)]
Unit = Annotated[str, Field(min_length=1, max_length=20, pattern=r"^[^\[\]\n\t]+$")]
_Row = tuple[_Cosine, _Cosine, _Cosine]
Point = tuple[_Length, _Length, _Length]
_ROUNDED = 1e-6  # rounding error of a rotation written with few digits


class PlacedEntry(Entry):
    """A pose: X_room = rotation X + translation."""

    rotation: tuple[_Row, _Row, _Row]
    translation: Point

    def place(self, what: str) -> Pose:
        """Raises InputError about `what` if the rotation is invalid."""
        rotation = np.array(self.rotation)
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > _ROUNDED or np.linalg.det(rotation) < 0:
            raise InputError(f"{what}: its rotation is invalid: the rows are not orthonormal and right-handed")
        return Pose(rotation, np.array(self.translation))


class _StationEntry(PlacedEntry):
    name: str = Field(min_length=1, max_length=1000)
    folder: str = Field(pattern=r"^captures/[0-9]{1,6}$")


class _RoomEntry(Entry):
    unit: Unit
    stations: list[_StationEntry] = Field(min_length=1, max_length=10_000)


@dataclass(frozen=True, eq=False)
class StoredStation:
    """A station's `name`, its `folder` relative to the result, and X_room = rotation X_camera + translation."""

    name: str
    folder: str
    place: Pose


@dataclass(frozen=True)
class StoredRoom:
    """The part of a room that other files need."""

    unit: str
    stations: tuple[StoredStation, ...]


def write_room(path: Path, entries: dict[str, Any]) -> None:
    """Write a room's entries, each item of a list as one line. Raises OSError."""
    lines = []
    for key, value in entries.items():
        if isinstance(value, list) and value:
            lines += [f"{key}:", *(f"  - {flow_yaml(item)}" for item in value)]
        else:
            lines.append(f"{key}: {flow_yaml(value)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_room(path: Path) -> StoredRoom:
    """Raises InputError if the file is missing or malformed, or holds no rotation."""
    entry = validate(_RoomEntry, read_yaml(path), str(path))
    stations = (
        StoredStation(station.name, station.folder, station.place(f"{path}: station {station.name}"))
        for station in entry.stations
    )
    return StoredRoom(entry.unit, tuple(stations))


class _PoseEntry(PlacedEntry):
    translation: Point = Field(alias="position")


class _PosesEntry(Entry):
    cameras: list[_PoseEntry] = Field(min_length=1)


def write_poses(path: Path, poses: Sequence[Pose], more: dict[str, Any] | None = None) -> None:
    """Write a pose for each capture, oldest first: X_cloud = rotation X_camera + position; `more` keys. Raises
    OSError.
    """
    cameras = [{"rotation": pose.rotation.tolist(), "position": pose.translation.tolist()} for pose in poses]
    write_room(path, {"cameras": cameras} | (more or {}))


def read_poses(path: Path, count: int) -> tuple[Pose, ...]:
    """The poses of `count` captures. Raises InputError if they are others, malformed, or hold no rotation."""
    entry = validate(_PosesEntry, read_yaml(path), str(path))
    if len(entry.cameras) != count:
        raise InputError(f"{path}: expected the cameras of {count} captures, found {len(entry.cameras)}")
    return tuple(camera.place(f"{path}: camera {number}") for number, camera in enumerate(entry.cameras, start=1))


class _NetworkDevice(DeviceEntry, PlacedEntry):
    # It becomes a file name.
    name: str = Field(min_length=1, max_length=200, pattern=r"^[^./\\\x00-\x1f][^/\\\x00-\x1f]*$")
    kind: Literal["camera", "projector"]


class _NetworkEntry(Entry):
    unit: Unit
    devices: list[_NetworkDevice] = Field(min_length=2, max_length=1000)


@dataclass(frozen=True, eq=False)
class StoredDevice:
    """X_network = rotation X_device + translation, as of `place`."""

    name: str
    kind: Literal["camera", "projector"]
    intrinsics: Intrinsics
    place: Pose


@dataclass(frozen=True)
class StoredNetwork:
    """The part of a network that other files need. All lengths are in `unit`."""

    unit: str
    devices: tuple[StoredDevice, ...]


def read_network(path: Path) -> StoredNetwork:
    """Raises InputError if the file is missing or malformed, holds no rotation, or two devices of one name."""
    entry = validate(_NetworkEntry, read_yaml(path), str(path))
    names = [device.name for device in entry.devices]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: has two devices that are called {twice}; each has a name of its own")
    devices = (
        StoredDevice(device.name, device.kind, device.intrinsics(), device.place(f"{path}: device {device.name}"))
        for device in entry.devices
    )
    return StoredNetwork(entry.unit, tuple(devices))
