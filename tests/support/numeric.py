"""Numerical derivatives."""

from collections.abc import Callable, Iterable

import numpy as np

from calib.numerics import Floats
from calib.rooms import Room


def gradient_of(
    function: Callable[[Room], Floats], room: Room, columns: Iterable[int] | None = None, step: float = 1e-6
) -> Floats:
    """Gradient of a function of rooms by some or all of the room's columns, (…, columns)."""
    slopes = []
    for column in range(room.size) if columns is None else columns:
        way = np.zeros(room.size)
        way[column] = step
        slopes.append((np.asarray(function(room.moved(way))) - function(room.moved(-way))) / (2 * step))
    return np.stack(slopes, axis=-1)
