"""The evidence that connects two parts of a group, each taken as rigid.

Every station of a room is connected to some others, even if half of the group is of another room, because bare corners
look alike. A group is as certain as its weakest connection. Candidates are found by removing each edge of the maximum
spanning tree of all pairs (Gower and Ross, "Minimum spanning trees and single linkage cluster analysis", 1969).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy

from calib.geometry import Pose
from calib.numerics import Floats, Ints
from calib.registration.agreement import DECIDED_NATS, NATS_OF_POSE, Agreement, compare_one, gain, nats_of_tilt
from calib.registration.range_view import Surfaces
from calib.registration.shared_planes import shared_planes


@dataclass(frozen=True)
class Cut:
    """`part`: stations, at most half of a group; `nats`: evidence that they belong to the others at their poses."""

    part: tuple[int, ...]
    nats: float


def firmly_connected(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> dict[int, Pose]:
    """What is left of a group, at `places` in the room, when all parts that little holds are cut off."""
    remaining = dict(places)
    while len(remaining) > 1:
        weakest = weakest_cut(surfaces, remaining)
        if weakest.nats >= DECIDED_NATS:
            break
        remaining = {k: place for k, place in remaining.items() if k not in weakest.part}
    return remaining


def weakest_cut(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> Cut:
    """Of a group of two stations or more, at `places` in the room."""
    cuts = [Cut(part, _nats(surfaces, places, part)) for part in _parts(surfaces, places)]
    return min(cuts, key=lambda cut: cut.nats)


def _nats(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose], part: Collection[int]) -> float:
    plane_of = shared_planes(surfaces, {k: places[k] for k in part}).plane_of
    planes = 1 + max((plane for own in plane_of.values() for plane in own), default=-1)
    seen, tilts = [], []
    for member in places:
        if member in part:
            continue
        for k in part:
            pose = places[member].inverse() @ places[k]
            seen.append(_of_planes(compare_one(surfaces[member], surfaces[k], pose), plane_of[k], planes))
            tilts.append(float(nats_of_tilt(pose)))
    return float(gain(seen)[0]) - min(tilts) - NATS_OF_POSE


def _of_planes(agreement: Agreement, plane_of: Sequence[int], planes: int) -> Agreement:
    """The view with the second station's labels replaced by their planes, of which there are this many."""
    is_on: Ints = np.eye(planes + 1, dtype=np.int64)[[*plane_of, -1]]
    matched: Ints = agreement.matched @ is_on
    return replace(agreement, matched=matched)


def _parts(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> Iterator[tuple[int, ...]]:
    """Each single station, and the part on one side of each edge of the spanning tree."""
    names = np.array(list(places))
    yield from ((int(k),) for k in names)
    worth: Floats = np.zeros((len(names), len(names)))
    for i, j in combinations(range(len(names)), 2):
        a, b = int(names[i]), int(names[j])
        worth[i, j] = gain([compare_one(surfaces[a], surfaces[b], places[a].inverse() @ places[b])])[0]
    cost = np.triu(1 + worth.max() - worth, 1)  # zero would mean no edge
    tree = scipy.sparse.csgraph.minimum_spanning_tree(cost).toarray()
    for edge in np.argwhere(tree):
        rest = tree.copy()
        rest[tuple(edge)] = 0
        side = scipy.sparse.csgraph.connected_components(rest, directed=False)[1].astype(np.bool_)
        part = side if 2 * np.count_nonzero(side) <= len(side) else ~side
        if np.count_nonzero(part) > 1:
            yield tuple(int(k) for k in names[part])
