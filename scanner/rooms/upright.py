"""The vertical direction of a room, and the frame of its results.

Cameras are roughly upright; the floor is the lowest of the large planes that face up, and z is its normal. x runs along
the wall with the largest visible area. The origin is on the floor, below the first station's camera.
"""

from collections.abc import Sequence

import numpy as np

from calib.geometry import Plane, Pose
from calib.numerics import Floats

_UPRIGHT, _LEVEL = float(np.cos(np.radians(30.0))), float(np.sin(np.radians(15.0)))
_FLOOR_OF_LARGEST = 0.15
_CAMERAS_UP = np.array([0.0, -1.0, 0.0])


def upright(places: Sequence[Pose], planes: Sequence[Plane], areas: Floats) -> tuple[Pose, int | None]:
    """X_up = rotation X + translation, and the number of the floor; None without a floor, if the cameras define up.

    `areas` (P,): visible area of each plane.
    """
    cameras_up = np.sum([place.rotation @ _CAMERAS_UP for place in places], axis=0)
    cameras_up /= np.linalg.norm(cameras_up)
    floor = _floor(planes, areas, cameras_up)
    up = cameras_up if floor is None else planes[floor].normal
    along = _along_a_wall(planes, areas, up)
    rotation = np.stack([along, np.cross(up, along), up])
    foot = places[0].translation
    height = 0.0 if floor is None else float(up @ foot) - planes[floor].offset
    return Pose(rotation, -rotation @ foot + np.array([0.0, 0.0, height])), floor


def ceiling_of(planes: Sequence[Plane], areas: Floats) -> int | None:
    """The highest large plane that faces down, in a frame whose z is up."""
    floors = [i for i, plane in enumerate(planes) if plane.normal[2] < -_UPRIGHT]
    large = [i for i in floors if areas[i] >= _FLOOR_OF_LARGEST * max(areas[k] for k in floors)]
    return max(large, key=lambda i: -planes[i].offset, default=None)


def is_vertical(plane: Plane) -> bool:
    """In a frame whose z is up."""
    return bool(abs(plane.normal[2]) < _LEVEL)


def _floor(planes: Sequence[Plane], areas: Floats, up: Floats) -> int | None:
    facing_up = [i for i, plane in enumerate(planes) if plane.normal @ up > _UPRIGHT]
    large = [i for i in facing_up if areas[i] >= _FLOOR_OF_LARGEST * max(areas[k] for k in facing_up)]
    return min(large, key=lambda i: planes[i].offset, default=None)


def _along_a_wall(planes: Sequence[Plane], areas: Floats, up: Floats) -> Floats:
    walls = [i for i, plane in enumerate(planes) if abs(plane.normal @ up) < _LEVEL]
    normal = planes[max(walls, key=lambda i: areas[i])].normal if walls else np.eye(3)[np.argmin(np.abs(up))]
    along = np.cross(normal, up)
    unit: Floats = along / np.linalg.norm(along)
    return unit
