"""What ties a room's stations: patches of planes, points that pictures show on them, contacts of curved surfaces.

A patch is a plane seen by one station. It depends on the rig's 21 columns and three of its own, the plane's tilts and
offset in the camera's frame. So its cells are summed over these 24 columns, and the sums are transferred to the room's
columns. A track is a point that pictures show on a plane: where its two rays meet the plane is one place.

A contact is a pair of neighbouring points of two stations, along the normal. The normal is the mean of both stations',
which cancels the curvature between the two points (Rusinkiewicz, "A symmetric objective function for ICP", 2019). The
points are triangulated with the estimated rig.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from calib.diagnostics import Uncertainty
from calib.estimation import ROBUST_SIGMAS, Cells, Term, block_inflation
from calib.geometry import PER_PLANE, PER_POSE, Matches, cross, tangent_basis, unproject
from calib.numerics import Bools, Floats, Ints, by_pixel, evenly, robust_sigma
from calib.refinement import CAMERA, PER_CORNER, SHARED, FurtherPlane, PlacedCorner, depths, predict
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
            by_pixels.append(from_camera @ by_pixel(lambda at_px: unproject(room.rig.camera, at_px)[0], pixels))
        return off, by_room, np.concatenate(by_pixels, axis=2)

    def misfit(self, room: Room) -> Term:
        """The cost, under Huber's loss."""
        off, by_room, _ = self.differences(room)
        root = np.sqrt(self.variance)[:, None]
        return Term.robust(self.columns(room), off / root, by_room / root[:, :, None])

    def __getitem__(self, chosen: Bools) -> "Track":
        """Some of the points."""
        pixels = self.pixels[0][chosen], self.pixels[1][chosen]
        return replace(self, pixels=pixels, variance=self.variance[chosen])


_DENSE, _MOST = 60_000, 4000  # points of a station, and number of them that search for neighbours
_NEIGHBOURS = 12
# If only surfaces constrain the stations, noisy normals attract points that are close by chance. This many neighbours
# blur the edges of furniture, which planes constrain better.
SMOOTH, _SHARE = 60, 1 / 1000  # the second as a share of a station's points: fewer neighbours where points are sparse
_FLAT = 0.2  # least over middle spread of a point's neighbours; a rougher place has no normal
_ALIKE = 0.94  # least scalar product of two normals
_FEWEST = 30


@dataclass(frozen=True, eq=False)
class Contact:
    """Neighbouring points of the stations `first` and `second`, as their matches, N of each.

    `normals` (N, 3): of the surface there, the mean of both stations', in the room's frame. `variance` (N,): of the
    distance along them.
    """

    first: int
    second: int
    matches: tuple[Matches, Matches]
    normals: Floats
    variance: Floats

    def columns(self, room: Room) -> Ints:
        """The room's columns that the distances depend on, (27,)."""
        every = np.arange(room.size, dtype=np.int32)
        places = (every[room.place_columns(station)] for station in (self.first, self.second))
        return np.concatenate([every[:SHARED], *places])

    def distances(self, room: Room) -> tuple[Floats, Floats, Floats]:
        """Of the first's points before the surface of the second (N,), derivatives (N, 27), and by pixels (N, 4)."""
        distances, by_room = np.zeros(len(self.normals)), np.zeros((len(self.normals), SHARED + 2 * PER_POSE))
        by_pixels = []
        for i, (station, matches, sign) in enumerate(
            zip((self.first, self.second), self.matches, (1, -1), strict=True)
        ):
            place = room.places[station]
            by_rig, by_match = Uncertainty(room.rig, np.zeros((0, 0)), None, 0.0).point_jacobians(matches)
            turned = place.rotate(_seen(room, matches))
            normals = sign * self.normals
            back = normals @ place.rotation
            own = slice(SHARED + PER_POSE * i, SHARED + PER_POSE * (i + 1))
            distances += np.sum(normals * (turned + place.translation), axis=1)
            by_room[:, :SHARED] += np.einsum("ni,nij->nj", back, by_rig)
            by_room[:, own] = np.hstack([cross(turned, normals), normals])
            by_pixels.append(np.einsum("ni,nij->nj", back, by_match))
        return distances, by_room, np.hstack(by_pixels)

    def noise_px(self, match_px: tuple[float, float]) -> Floats:
        """Of each point in either station (N, 2): as its matches state it, or else as given."""
        return np.stack(
            [
                np.full(len(station_matches), px) if station_matches.sigma_px is None else station_matches.sigma_px
                for station_matches, px in zip(self.matches, match_px, strict=True)
            ],
            axis=1,
        )

    def misfit(self, room: Room) -> Term:
        """The cost, under Huber's loss."""
        distances, by_room, _ = self.distances(room)
        root = np.sqrt(self.variance)[:, None]
        return Term.robust(self.columns(room), distances[:, None] / root, (by_room / root)[:, None])


def find_contacts(
    loose: Sequence[Matches], room: Room, match_px: Sequence[float], radius: float, neighbours: int = _NEIGHBOURS
) -> tuple[Contact, ...]:
    """Contacts between the matches of all stations that are on no plane, up to `radius` apart, in baselines.

    `match_px`: each station's noise, if its matches state none. `neighbours`: number of neighbours for a normal.
    """
    matches = [station_matches[evenly(np.ones(len(station_matches), np.bool_), _DENSE)] for station_matches in loose]
    points = [place @ _seen(room, station_matches) for station_matches, place in zip(matches, room.places, strict=True)]
    trees = [cKDTree(point) for point in points]
    normals = [_normals(station_points, tree, neighbours) for station_points, tree in zip(points, trees, strict=True)]
    contacts = []
    for first, second in combinations(range(len(matches)), 2):
        if min(len(points[first]), len(points[second])) < _FEWEST:
            continue
        some = evenly(np.isfinite(normals[first][:, 0]), _MOST)
        apart, nearest = trees[second].query(points[first][some], distance_upper_bound=radius)
        # Each point counts once, for the nearest point that searched it, so that its error is not counted several
        # times.
        order = np.argsort(apart)[: np.count_nonzero(np.isfinite(apart))]
        there, once = np.unique(np.asarray(nearest, np.int64)[order], return_index=True)
        near = some[order[once]]
        first_normals, second_normals = normals[first][near], normals[second][there]
        product = np.sum(first_normals * second_normals, axis=1)
        alike = np.abs(product) > _ALIKE
        if np.count_nonzero(alike) < _FEWEST:
            continue
        mean = (first_normals * np.sign(product)[:, None] + second_normals)[alike]
        mean /= np.linalg.norm(mean, axis=1, keepdims=True)
        pair = matches[first][near[alike]], matches[second][there[alike]]
        contact = Contact(first, second, pair, mean, np.ones(len(mean)))
        contacts.append(replace(contact, variance=_variance(contact, room, (match_px[first], match_px[second]))))
    return tuple(contacts)


def _seen(room: Room, matches: Matches) -> Floats:
    """Triangulated points (N, 3) in the camera's frame."""
    rays, _ = unproject(room.rig.camera, matches.camera_px)
    return rays * depths(room.rig, rays, matches.projector_px)[:, None]


def _normals(points: Floats, tree: "cKDTree[None]", most: int) -> Floats:
    """Normals of the surface at each point (N, 3) from its neighbours; NaN where undetermined."""
    count = int(np.clip(_SHARE * len(points), _NEIGHBOURS, most))
    if len(points) < count:
        return np.full_like(points, np.nan)
    _, neighbours = tree.query(points, count)
    around = points[np.asarray(neighbours)]
    around = around - around.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(around.transpose(0, 2, 1) @ around)
    flat = np.sqrt(np.maximum(spread[:, 0], 0.0)) < _FLAT * np.sqrt(np.maximum(spread[:, 1], 0.0))
    return np.where(flat[:, None], axes[:, :, 0], np.nan)


def _variance(contact: Contact, room: Room, match_px: tuple[float, float]) -> Floats:
    """Variances from the noise of matches, enlarged for the observed distances and for errors that correlate within
    blocks.
    """
    distances, _, by_pixels = contact.distances(room)
    noise = contact.noise_px(match_px)
    variance: Floats = np.sum((by_pixels * np.repeat(noise, 2, axis=1)) ** 2, axis=1)
    variance *= max(1.0, robust_sigma(distances / np.sqrt(variance)) ** 2)
    relative = np.clip(distances / np.sqrt(variance), -ROBUST_SIGMAS, ROBUST_SIGMAS)
    return variance * block_inflation(contact.matches[0].camera_px, relative)
