"""A plane of a room."""

from dataclasses import dataclass

from calib.numerics import Floats


@dataclass(frozen=True, eq=False)
class RoomPlane:
    """normal · X = offset in the room's frame; `normal` (3,): unit, to the side from which the plane was seen."""

    normal: Floats
    offset: float
