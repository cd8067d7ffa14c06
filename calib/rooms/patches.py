"""A plane of the room seen by one station: predicted cells, and their derivatives.

A patch depends on the rig's 21 columns and three of its own, the plane's tilts and offset in the camera's frame. So its
cells are summed over these 24 columns, and the sums are transferred to the room's columns.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import PER_PLANE, PER_POSE, cross, tangent_basis, unproject
from calib.numerics import Floats, Ints
from calib.refinement import PER_CORNER, SHARED, Cells, FurtherPlane, PlacedCorner, predict
from calib.rooms.room import Room

OWN = slice(SHARED, SHARED + PER_PLANE)  # columns of a patch for its plane in the camera's frame
PER_PATCH = OWN.stop

# A plane in the camera's frame is a further plane of a corner at the camera's centre, whose own columns have no effect.
_FURTHER = 3
_OF_PLANE = np.r_[0:SHARED, SHARED + PER_CORNER + PER_POSE : SHARED + PER_CORNER + PER_POSE + PER_PLANE]


@dataclass(frozen=True, eq=False)
class Patch:
    """The `cells` of one plane of the room at one station."""

    station: int
    plane: int
    cells: Cells

    @property
    def capture(self) -> int:
        """The station, whose capture it is of."""
        return self.station

    def predict(self, room: Room, camera_px: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Projector pixels (N, 2) of its cells, or of `camera_px`, their Jacobian (N, 2, 24), and depths (N, 2).

        Depths are those before both devices, not positive where the prediction means nothing.
        """
        place, plane = room.places[self.station], room.planes[self.plane]
        pixels = self.cells.camera_px if camera_px is None else camera_px
        axes = np.stack([plane.normal, *tangent_basis(plane.normal).T]) @ place.rotation
        height = plane.offset_from(place.translation)
        free = (np.inf, np.inf)
        corner = PlacedCorner(np.eye(3), np.zeros(3), planes=(FurtherPlane(axes, np.zeros(2), height, free),))
        state = replace(room.rig, off_square=np.zeros((1, PER_CORNER)), corners=(corner,))
        predicted, jacobian, depths = predict(state, pixels, np.full(len(pixels), _FURTHER, np.int32))
        return predicted, np.ascontiguousarray(jacobian[:, :, _OF_PLANE]), depths

    def points(self, room: Room) -> Floats:
        """Where the rays of its cells meet the plane, (M, 3) in the room's frame."""
        rays, _ = unproject(room.rig.camera, self.cells.camera_px)
        _, _, depths = self.predict(room)
        place = room.places[self.station]
        return place @ (rays * depths[:, :1])

    def columns(self, room: Room) -> Ints:
        """The room's columns that it depends on, (30,): those of the rig, its station's place and its plane."""
        every = np.arange(room.size, dtype=np.int32)
        return np.concatenate(
            [every[:SHARED], every[room.place_columns(self.station)], every[room.plane_columns(self.plane)]]
        )

    def carried(self, room: Room) -> Floats:
        """Derivatives of its own columns by `columns`, (24, 30).

        In the camera's frame the plane n · X = d is Rᵀn · X = d − n · t. A rotation ω of the pose tilts it by eₖ · (n ×
        ω) along each eₖ of the normal's tangent basis; a tilt a of the plane also moves it by −a eₖ · t.
        """
        place, plane = room.places[self.station], room.planes[self.plane]
        basis = tangent_basis(plane.normal).T
        by_room = np.zeros((PER_PATCH, SHARED + PER_POSE + PER_PLANE))
        by_room[:SHARED, :SHARED] = np.eye(SHARED)
        tilts, offset = slice(OWN.start, OWN.start + 2), OWN.start + 2
        turn, shift = slice(SHARED, SHARED + 3), slice(SHARED + 3, SHARED + PER_POSE)
        by_room[tilts, turn] = cross(basis, plane.normal)
        by_room[offset, shift] = -plane.normal
        by_room[OWN, SHARED + PER_POSE :] = np.eye(PER_PLANE)
        by_room[offset, SHARED + PER_POSE : SHARED + PER_POSE + 2] = -basis @ place.translation
        return by_room


def patches_of(stations: Sequence[Cells], plane_of: Sequence[Sequence[int]]) -> tuple[Patch, ...]:
    """The patches of all stations; `plane_of`: for each station, which plane of the room a label is, −1 for none."""
    return tuple(
        Patch(station, plane_of[station][label], cells[cells.plane == label])
        for station, cells in enumerate(stations)
        for label in np.unique(cells.plane)
        if 0 <= label < len(plane_of[station]) and plane_of[station][label] >= 0
    )
