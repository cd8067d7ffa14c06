"""A rig, its places in a room and the room's planes: minimal parameters, and steps in their tangent space.

Lengths are in the rig's baselines. The room's frame is the camera's at the first station.

Columns of every step, gradient and Hessian: the 21 of the rig, as in `calib.refinement`; for each station the rotation
(3) about the room's axes and the translation (3) of its place; for each plane two tilts, along `tangent_basis` of its
normal, and its offset.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry import PER_PLANE, PER_POSE, Plane, Pose
from calib.numerics import Floats
from calib.refinement import SHARED, State


@dataclass(frozen=True, eq=False)
class Room:
    """`rig`: a state without corners. `places`: of the stations, X_room = rotation X_camera + translation."""

    rig: State
    places: tuple[Pose, ...]
    planes: tuple[Plane, ...]

    @property
    def size(self) -> int:
        """Number of columns."""
        return SHARED + PER_POSE * len(self.places) + PER_PLANE * len(self.planes)

    def place_columns(self, station: int) -> slice:
        """Columns of a station's place."""
        return slice(SHARED + PER_POSE * station, SHARED + PER_POSE * (station + 1))

    def plane_columns(self, plane: int) -> slice:
        """Columns of a plane."""
        start = SHARED + PER_POSE * len(self.places) + PER_PLANE * plane
        return slice(start, start + PER_PLANE)

    def moved(self, step: Floats) -> "Room":
        """The room after a step (size,) in the columns' coordinates."""
        return Room(
            self.rig.moved(step[:SHARED]),
            tuple(place.retract(step[self.place_columns(i)]) for i, place in enumerate(self.places)),
            tuple(plane.retract(step[self.plane_columns(i)]) for i, plane in enumerate(self.planes)),
        )

    def step_to(self, other: "Room") -> Floats:
        """The step (size,) from here to a room of the same layout not too far away."""
        step = np.zeros(self.size)
        step[:SHARED] = self.rig.step_to(other.rig)
        for i, (here, there) in enumerate(zip(self.places, other.places, strict=True)):
            step[self.place_columns(i)] = here.local(there)
        for i, (plane, true) in enumerate(zip(self.planes, other.planes, strict=True)):
            step[self.plane_columns(i)] = plane.local(true)
        return step
