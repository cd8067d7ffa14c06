"""A plane of a room."""

from dataclasses import dataclass

from calib.numerics import Floats


@dataclass(frozen=True, eq=False)
class RoomPlane:
    """The points X with `normal` · X = `offset`; `normal` (3,), of length 1, points to the side it was seen from."""

    normal: Floats
    offset: float
