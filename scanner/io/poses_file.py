"""`poses.yaml`: the camera poses of all captures in the frame of a merged cloud."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io.room_file import PlacedEntry, Point
from scanner.io.validation import Entry, validate
from scanner.io.yaml_text import flow_yaml, read_yaml


class _PoseEntry(PlacedEntry):
    translation: Point = Field(alias="position")


class _PosesEntry(Entry):
    cameras: list[_PoseEntry] = Field(min_length=1)


def write_poses(path: Path, poses: Sequence[Floats]) -> None:
    """Write a pose (3, 4) for each capture, oldest first: X_cloud = rotation X_camera + position. Raises OSError."""
    lines = [f"  - {flow_yaml({'rotation': pose[:, :3].tolist(), 'position': pose[:, 3].tolist()})}" for pose in poses]
    path.write_text("\n".join(["cameras:", *lines]) + "\n", encoding="utf-8")


def read_poses(path: Path, count: int) -> tuple[Floats, ...]:
    """The poses (3, 4) of `count` captures. Raises InputError if they are others, malformed, or hold no rotation."""
    entry = validate(_PosesEntry, read_yaml(path), str(path))
    if len(entry.cameras) != count:
        raise InputError(f"{path}: expected the cameras of {count} captures, found {len(entry.cameras)}")
    places = (camera.place(f"{path}: camera {number}") for number, camera in enumerate(entry.cameras, start=1))
    return tuple(np.column_stack([place.rotation, place.translation]) for place in places)
