"""What pictures show on a plane ties stations along it: each point is where its two rays meet the plane, one place."""

from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import PER_PLANE, PER_POSE, cross, tangent_basis, unproject
from calib.numerics import Bools, Floats, Ints, by_pixel, huber_loss, huber_weights
from calib.refinement import CAMERA, ROBUST_SIGMAS, SHARED
from calib.rooms.room import Room

_COLUMNS = SHARED + 2 * PER_POSE + PER_PLANE


@dataclass(frozen=True, eq=False)
class Track:
    """Points of a plane of the room that the stations `first` and `second` see at `pixels`, (N, 2) each.

    `variance` (N,): of either difference along the plane, in squared baselines.
    """

    first: int
    second: int
    plane: int
    pixels: tuple[Floats, Floats]
    variance: Floats

    def columns(self, room: Room) -> Ints:
        """The room's columns that the differences depend on, (36,)."""
        every = np.arange(room.size, dtype=np.int32)
        places = (every[room.place_columns(station)] for station in (self.first, self.second))
        return np.concatenate([every[:SHARED], *places, every[room.plane_columns(self.plane)]])

    def differences(self, room: Room) -> tuple[Floats, Floats, Floats]:
        """Positions of the first on the plane minus the second's (N, 2); derivatives (N, 2, 36), and by pixels (N, 2,
        4).

        The axes rotate with the plane, and both points with them, which changes a nonzero difference.
        """
        plane = room.planes[self.plane]
        axes = tangent_basis(plane.normal)
        off, by_room = np.zeros((len(self.variance), 2)), np.zeros((len(self.variance), 2, _COLUMNS))
        by_pixels = []
        for i, (station, pixels, sign) in enumerate(zip((self.first, self.second), self.pixels, (1, -1), strict=True)):
            place = room.places[station]
            rays, by_camera = unproject(room.rig.camera, pixels)
            turned = place.rotate(rays)
            facing = turned @ plane.normal
            depth = plane.offset_from(place.translation) / facing
            at = depth[:, None] * turned
            # A point moves along its ray back to the plane; only the displacement along the plane counts.
            onto = axes.T - (turned @ axes / facing[:, None])[:, :, None] * plane.normal
            off += sign * (at + place.translation) @ axes
            along_ray = sign * turned @ axes / facing[:, None]
            from_camera = sign * depth[:, None, None] * (onto @ place.rotation)
            by_room[:, :, CAMERA] += from_camera @ by_camera
            own = SHARED + PER_POSE * i
            turns = np.stack([cross(at, row) for row in np.swapaxes(onto, 0, 1)], axis=1)
            by_room[:, :, own : own + 3] = sign * turns
            by_room[:, :, own + 3 : own + PER_POSE] = sign * onto
            by_room[:, :, -PER_PLANE:-1] -= along_ray[:, :, None] * ((at + place.translation) @ axes)[:, None]
            by_room[:, :, -1] += along_ray
            by_pixels.append(from_camera @ by_pixel(lambda seen: unproject(room.rig.camera, seen)[0], pixels))
        return off, by_room, np.concatenate(by_pixels, axis=2)

    def misfit(self, room: Room) -> tuple[float, Floats, Floats]:
        """Cost under Huber's loss, half its gradient (36,) and its Gauss–Newton Hessian (36, 36)."""
        off, by_room, _ = self.differences(room)
        size = np.linalg.norm(off, axis=1) / np.sqrt(self.variance)
        cost = float(np.sum(huber_loss(size, ROBUST_SIGMAS)))
        weighted = by_room * (huber_weights(size, ROBUST_SIGMAS) / self.variance)[:, None, None]
        return cost, np.einsum("nac,na->c", weighted, off), np.einsum("nac,nad->cd", weighted, by_room)

    def __getitem__(self, chosen: Bools) -> "Track":
        """Some of the points."""
        pixels = self.pixels[0][chosen], self.pixels[1][chosen]
        return replace(self, pixels=pixels, variance=self.variance[chosen])
