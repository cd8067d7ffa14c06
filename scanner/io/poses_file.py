"""`poses.yaml`: the camera poses of all captures in the frame of a merged cloud."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io.validation import Entry, Number, validate
from scanner.io.yaml_text import flow_yaml, read_yaml

_Cosine = Annotated[Number, Field(ge=-2, le=2)]
_Row = tuple[_Cosine, _Cosine, _Cosine]
_Length = Annotated[Number, Field(ge=-1e12, le=1e12)]
_ROUNDED = 1e-6  # rounding error of a rotation written with few digits


class _PoseEntry(Entry):
    rotation: tuple[_Row, _Row, _Row]
    position: tuple[_Length, _Length, _Length]


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
    poses = tuple(np.column_stack([np.array(camera.rotation), camera.position]) for camera in entry.cameras)
    for number, pose in enumerate(poses, start=1):
        turned = pose[:, :3] @ pose[:, :3].T
        if np.abs(turned - np.eye(3)).max() > _ROUNDED:
            raise InputError(f"{path}: the rotation of camera {number} is invalid: its rows are not orthonormal")
    return poses
