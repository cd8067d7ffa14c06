"""Derivatives by differences."""

from collections.abc import Callable

import numpy as np

from calib.numerics import Floats
from calib.rooms import Room


def gradient_of(function: Callable[[Room], Floats], room: Room, step: float = 1e-6) -> Floats:
    """Of a function of rooms by the room's columns, (…, size)."""
    columns = []
    for column in range(room.size):
        way = np.zeros(room.size)
        way[column] = step
        columns.append((np.asarray(function(room.moved(way))) - function(room.moved(-way))) / (2 * step))
    return np.stack(columns, axis=-1)
