"""Walls and the ceiling of a room in its cloud, which are seen through from outside."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats
from scanner.viewing.result import ViewedCloud

_LEVEL, _DOWN = 0.2, -0.95  # of a wall's and a ceiling's normal, along the upright axis
_SECTORS = 12  # of directions that walls face
_THICK_OF_ROOM = 0.04  # what is closer to the outermost points of a wall belongs to it: pictures, no cupboards
_OUTERMOST = 0.02
_LEAST_SHARE = 0.01  # of the cloud's points


class PartKind(StrEnum):
    """What can be seen through or left out."""

    WALL = "Walls"
    CEILING = "Ceiling"


@dataclass(frozen=True, eq=False)
class RoomPart:
    """A wall or the ceiling."""

    kind: PartKind
    normal: Floats
    """Into the room, (3,)."""
    offset: float
    """normal · X of its points."""
    points: NDArray[np.int64]
    """Their numbers in the cloud, (n,)."""

    def is_before(self, position: Floats) -> bool:
        """Whether who looks from `position` (3,) looks at its back."""
        return bool(self.normal @ position < self.offset)


def room_parts(cloud: ViewedCloud) -> tuple[RoomPart, ...]:
    """The walls, by the direction that they face, and the ceiling; none of a thing, whose sides face outwards."""
    if not cloud.has_walls or not np.any(cloud.normals):
        return ()
    up = cloud.up / np.linalg.norm(cloud.up)
    along_up = cloud.normals @ up
    inwards = np.einsum("ni,ni->n", cloud.normals, np.median(cloud.points, axis=0) - cloud.points) > 0
    first, second = _level_axes(up)
    facing = np.arctan2(cloud.normals @ second, cloud.normals @ first)
    walls = (np.abs(along_up) < _LEVEL) & inwards
    # Sectors have a wall in the middle, not at their edge, where most rooms have all four walls.
    turn = _common_turn(facing[walls])
    sector = np.rint((facing - turn) / (2 * np.pi / _SECTORS)).astype(np.int64) % _SECTORS
    sides = [_part(cloud, PartKind.WALL, walls & (sector == number)) for number in range(_SECTORS)]
    sides.append(_part(cloud, PartKind.CEILING, (along_up < _DOWN) & inwards))
    return tuple(part for part in sides if part is not None)


def _part(cloud: ViewedCloud, kind: PartKind, candidates: Bools) -> RoomPart | None:
    chosen = np.flatnonzero(candidates)
    if len(chosen) < max(1, _LEAST_SHARE * len(cloud.points)):
        return None
    normal = np.median(cloud.normals[chosen], axis=0)
    normal /= np.linalg.norm(normal)
    offsets = cloud.points[chosen] @ normal
    outermost = float(np.quantile(offsets, _OUTERMOST))
    along = cloud.points @ normal
    low, high = np.quantile(along, (0.01, 0.99))
    thick = _THICK_OF_ROOM * float(high - low)
    if outermost > low + 2 * thick:  # the front of a cupboard: there is more of the room behind it
        return None
    on = offsets < outermost + thick
    return RoomPart(kind, normal, outermost, chosen[on])


def _level_axes(up: Floats) -> tuple[Floats, Floats]:
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    return first, np.cross(up, first)


def _common_turn(facing: Floats) -> float:
    """By how much walls that stand square to each other are turned, in radians."""
    return float(np.angle(np.sum(np.exp(4j * facing)))) / 4 if len(facing) else 0.0
