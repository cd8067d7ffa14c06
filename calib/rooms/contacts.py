"""Non-planar surfaces also connect stations: by neighbouring points of two of them, along the normal.

The normal is the mean of both stations', which cancels the curvature between the two points (Rusinkiewicz, "A symmetric
objective function for ICP", 2019). The points are triangulated with the estimated rig.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from calib.diagnostics import Uncertainty
from calib.estimation import block_inflation
from calib.geometry import PER_POSE, Matches, cross, unproject
from calib.numerics import Floats, Ints, evenly, huber_loss, huber_weights, robust_sigma
from calib.refinement import ROBUST_SIGMAS, SHARED, depths
from calib.rooms.room import Room

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
                np.full(len(each), px) if each.sigma_px is None else each.sigma_px
                for each, px in zip(self.matches, match_px, strict=True)
            ],
            axis=1,
        )

    def misfit(self, room: Room) -> tuple[float, Floats, Floats]:
        """Cost under Huber's loss, half its gradient (27,) and its Gauss–Newton Hessian (27, 27)."""
        distances, by_room, _ = self.distances(room)
        size = np.abs(distances) / np.sqrt(self.variance)
        weighted = by_room * (huber_weights(size, ROBUST_SIGMAS) / self.variance)[:, None]
        return float(np.sum(huber_loss(size, ROBUST_SIGMAS))), weighted.T @ distances, weighted.T @ by_room


def find_contacts(
    loose: Sequence[Matches], room: Room, match_px: Sequence[float], radius: float, neighbours: int = _NEIGHBOURS
) -> tuple[Contact, ...]:
    """Contacts between the matches of all stations that are on no plane, up to `radius` apart, in baselines.

    `match_px`: each station's noise, if its matches state none. `neighbours`: number of neighbours for a normal.
    """
    matches = [each[evenly(np.ones(len(each), np.bool_), _DENSE)] for each in loose]
    points = [place @ _seen(room, each) for each, place in zip(matches, room.places, strict=True)]
    trees = [cKDTree(each) for each in points]
    normals = [_normals(each, tree, neighbours) for each, tree in zip(points, trees, strict=True)]
    found = []
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
        here, other = normals[first][near], normals[second][there]
        product = np.sum(here * other, axis=1)
        alike = np.abs(product) > _ALIKE
        if np.count_nonzero(alike) < _FEWEST:
            continue
        mean = (here * np.sign(product)[:, None] + other)[alike]
        mean /= np.linalg.norm(mean, axis=1, keepdims=True)
        pair = matches[first][near[alike]], matches[second][there[alike]]
        contact = Contact(first, second, pair, mean, np.ones(len(mean)))
        found.append(replace(contact, variance=_variance(contact, room, (match_px[first], match_px[second]))))
    return tuple(found)


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
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
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
