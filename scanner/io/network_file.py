"""`network.yaml`: pose and intrinsics of every camera and projector of a network."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from calib.geometry import Intrinsics, Pose
from scanner.errors import InputError
from scanner.io.calibration_file import DeviceEntry
from scanner.io.room_file import PlacedEntry, Unit
from scanner.io.validation import Entry, validate
from scanner.io.yaml_text import read_yaml


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
