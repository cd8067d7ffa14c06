"""Lengths, heights and angles in an estimated room, each with the sigma that the whole estimate's covariance gives it.

Lengths are in baselines, as the room is.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry import tangent_basis
from calib.numerics import Floats
from calib.rooms.estimate import RoomEstimate

_PARALLEL = 1e-4  # sine of an angle too small to have a direction


@dataclass(frozen=True)
class Measured:
    """A number with its standard deviation; NaN where a plane that it needs has no cells."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False)
class RoomPoint:
    """A point (3,) in the room's frame, and how it follows the room's columns (3, size)."""

    position: Floats
    by_room: Floats


def angle_deg(estimate: RoomEstimate, first: int, second: int) -> Measured:
    """Between two planes, in degrees, as inside a corner that they make: 90 for square walls, 0 for facing ones."""
    a, b = (estimate.room.planes[plane].normal for plane in (first, second))
    cosine, sine = float(a @ b), float(np.linalg.norm(np.cross(a, b)))
    gradient = np.zeros(estimate.room.size)
    for plane, own, opposite in ((first, a, b), (second, b, a)):
        start = estimate.room.plane_columns(plane).start
        # Parallel planes open in any direction that they move; choose one.
        slope = tangent_basis(own).T @ opposite / sine if sine > _PARALLEL else np.array([1.0, 0.0])
        gradient[start : start + 2] = slope
    angle = np.pi - np.arctan2(sine, cosine)
    return Measured(float(np.degrees(angle)), float(np.degrees(_sigma(estimate, gradient))))


def gap(estimate: RoomEstimate, first: int, second: int) -> Measured:
    """Distance between two facing planes, perpendicular to the first.

    It is taken midway between the middles of their visible parts, because planes are never exactly parallel.
    """
    room = estimate.room
    plane, opposite = room.planes[first], room.planes[second]
    middle = (centre_of(estimate, first) + centre_of(estimate, second)) / 2
    above = float(plane.heights(middle))
    foot = middle - above * plane.normal
    signed = float(opposite.heights(foot))
    gradient = np.zeros(room.size)
    columns, basis = room.plane_columns(first), tangent_basis(plane.normal)
    facing = float(opposite.normal @ plane.normal)
    gradient[columns] = [*-(facing * basis.T @ middle + above * basis.T @ opposite.normal), facing]
    gradient[room.plane_columns(second)] = [*tangent_basis(opposite.normal).T @ foot, -1.0]
    return Measured(abs(signed), _sigma(estimate, gradient))


def vertex(estimate: RoomEstimate, first: int, second: int, third: int) -> RoomPoint:
    """Where three planes meet. Raises LinAlgError if two are parallel."""
    room, numbers = estimate.room, (first, second, third)
    normals = np.stack([room.planes[number].normal for number in numbers])
    inverse = np.linalg.inv(normals)
    position: Floats = inverse @ np.array([room.planes[number].offset for number in numbers])
    by_room = np.zeros((3, room.size))
    for number, column in zip(numbers, inverse.T, strict=True):  # N δX = δd − δn · X
        tilts = -tangent_basis(room.planes[number].normal).T @ position
        by_room[:, room.plane_columns(number)] = np.outer(column, [*tilts, 1.0])
    return RoomPoint(position, by_room)


def distance(estimate: RoomEstimate, first: RoomPoint, second: RoomPoint) -> Measured:
    """Between two points of the room."""
    apart = second.position - first.position
    length = float(np.linalg.norm(apart))
    direction = apart / length
    return Measured(length, _sigma(estimate, direction @ (second.by_room - first.by_room)))


def centre_of(estimate: RoomEstimate, plane: int) -> Floats:
    """The middle (3,) of the visible part of a plane, by cells; NaN without any."""
    points = [patch.points(estimate.room) for patch in estimate.patches if patch.plane == plane]
    return np.concatenate(points).mean(axis=0) if points else np.full(3, np.nan)


def _sigma(estimate: RoomEstimate, gradient: Floats) -> float:
    """Of a number with this gradient (size,); only the columns that it depends on need be known."""
    on = np.flatnonzero(gradient)
    return float(np.sqrt(gradient[on] @ estimate.covariance[np.ix_(on, on)] @ gradient[on]))
