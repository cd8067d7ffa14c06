"""Evidence within a group of stations: planes that they share, the weakest connection, and the station that fits worst.

Two plane segments are one plane of the room if patches of one, seen from the other's camera, lie on the other. A chain
of such pairs forms a plane. It has one segment per station, because planes that are separate there stay separate.

Every station of a room is connected to some others, even if half of the group is of another room, because bare corners
look alike. A group is as certain as its weakest connection. Candidates are found by removing each edge of the maximum
spanning tree of all pairs (Gower and Ross, "Minimum spanning trees and single linkage cluster analysis", 1969).

Calibration errors bend all stations of one unchanged rig equally, so that the surfaces of any two fit equally well. A
changed rig measures other shapes, and so does a changed room.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Plane, Pose
from calib.numerics import Floats, Ints
from calib.registration.agreement import COARSE, DECIDED_NATS, Agreement, compare_one, gain, nats_of_place
from calib.registration.alignment import normal_equations
from calib.registration.range_view import Surfaces

_FEWEST = 6
# Largest relative distance of overlapping segments of one plane.
_APART = 0.006

Segment = tuple[int, int]  # number of the station, label


@dataclass(frozen=True)
class SharedPlanes:
    """`planes` of the room, the ones that most stations share first; `plane_of`: for each station, of each of its
    labels the index of the plane, −1 for a segment with too few patches.
    """

    planes: tuple[Plane, ...]
    plane_of: dict[int, tuple[int, ...]]


def shared_planes(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> SharedPlanes:
    """Of stations at `places` in the room."""
    classes = _classes(surfaces, places)
    planes = tuple(_plane(surfaces, places, members) for members in classes)
    number = {segment: n for n, members in enumerate(classes) for segment in members}
    plane_of = {k: tuple(number.get((k, label), -1) for label in range(len(surfaces[k].planes))) for k in places}
    return SharedPlanes(planes, plane_of)


def patches_on(surfaces: Surfaces, label: int) -> Floats:
    """Patches (N, 3) of a segment, in the camera's frame."""
    on: Floats = surfaces.patches.points[surfaces.patch_labels == label]
    return on


def _classes(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> list[list[Segment]]:
    member_of: dict[Segment, list[Segment]] = {
        (k, label): [(k, label)]
        for k in places
        for label in range(len(surfaces[k].planes))
        if surfaces[k].plane_area[label] >= _FEWEST
    }
    links = sorted(_links(surfaces, places), key=lambda link: -link[0])
    for _, one, other in links:
        if one not in member_of or other not in member_of:
            continue
        here, there = member_of[one], member_of[other]
        if here is there or {k for k, _ in here} & {k for k, _ in there}:
            continue
        here += there
        for segment in there:
            member_of[segment] = here
    distinct = {id(members): sorted(members) for members in member_of.values()}
    return sorted(distinct.values(), key=lambda members: (-len(members), members))


def _links(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> list[tuple[int, Segment, Segment]]:
    """Pairs of coinciding segments, and the number of patches as evidence."""
    planes = []
    names = sorted(places)
    for n, i in enumerate(names):
        for j in names[n + 1 :]:
            pose = places[i].inverse() @ places[j]
            matched = compare_one(surfaces[i], surfaces[j], pose).matched[0, :-1, :-1]
            for a, b in np.argwhere(matched >= _FEWEST):
                if _one_plane(surfaces[i], int(a), surfaces[j], int(b), pose):
                    planes.append((int(matched[a, b]), (i, int(a)), (j, int(b))))
    return planes


def _one_plane(first: Surfaces, a: int, second: Surfaces, b: int, pose: Pose) -> bool:
    """Whether two segments coincide where they are near each other; `pose`: X_first = R X_second + t."""
    moved = pose @ patches_on(second, b)
    own = patches_on(first, a)
    off = moved @ first.planes[a, :3] - first.planes[a, 3]
    back = pose.undo(own) @ second.planes[b, :3] - second.planes[b, 3]
    apart = min(abs(float(np.median(heights))) for heights in (off, back))
    return apart < _APART * (first.distance + second.distance) / 2


def _plane(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose], members: Sequence[Segment]) -> Plane:
    """Least squares through all patches, distant ones weighing less, in the room's frame."""
    points, weights, eyes = [], [], []
    for k, label in members:
        own = patches_on(surfaces[k], label)
        points.append(places[k] @ own)
        weights.append(1 / own[:, 2] ** 2)
        eyes.append(places[k].translation)
    return Plane.through(np.concatenate(points), np.concatenate(weights), np.mean(eyes, axis=0))


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
    across = [(member, k) for member in places if member not in part for k in part]
    poses = [places[member].inverse() @ places[k] for member, k in across]
    agreements = [
        _of_planes(compare_one(surfaces[member], surfaces[k], pose), plane_of[k], planes)
        for (member, k), pose in zip(across, poses, strict=True)
    ]
    return nats_of_place(agreements, poses)


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


_MOST_CONTRADICTION = 0.05
_MOST_TIMES_WORSE = 1.8
_LEAST_PATCHES = 30
# Prior from a relative error of the calibration, with the weight of this many patches.
_OFF, _SUPPOSED_PATCHES = 0.002, 500.0

ANOTHER_ROOM = FindingKind(
    "another-room",
    "A station is left out: it is of another room, or something was moved.",
    "Leave it out, or take it again with everything at its place.",
    ("looked_through_share",),
)
SOMETHING_MOVED = FindingKind(
    "something-moved",
    "A station is left out: its surfaces are bent otherwise than those of all others.",
    "Do not change the rig between stations, let nothing move, and take the station again.",
    ("deviation_ratio",),
)


@dataclass(frozen=True)
class Misfit:
    """`contradiction`: share of what `station` and others could see of each other that was looked through;
    `times_worse`: its surfaces' distances from the others', over what those of the others among each other let expect.
    """

    station: int
    contradiction: float
    times_worse: float

    @property
    def of_another_shape(self) -> bool:
        """Whether it belongs nowhere, for its surfaces are bent otherwise than all others'."""
        return self.times_worse > _MOST_TIMES_WORSE

    @property
    def finding(self) -> Finding | None:
        """Why it is to be left out, as a clause; None if it is not."""
        if self.of_another_shape:
            return Finding(
                SOMETHING_MOVED,
                Severity.WARNING,
                f"its surfaces deviate {self.times_worse:.1f} times as far from the other stations' as those from each "
                "other: the rig was changed, or something was moved",
                data={"deviation_ratio": self.times_worse},
            )
        if self.contradiction > _MOST_CONTRADICTION:
            return Finding(
                ANOTHER_ROOM,
                Severity.WARNING,
                f"where it fits best, {self.contradiction:.0%} of the surfaces in common view are in space that one of "
                "the stations saw as free: it is of another room, or something was moved",
                data={"looked_through_share": self.contradiction},
            )
        return None


def worst_misfit(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> Misfit | None:
    """The station of a group that fits the others worst; None where only two overlap, for none is then to blame."""
    sums: dict[tuple[int, int], Floats] = {}
    for i, j in combinations(places, 2):
        agreement = compare_one(surfaces[i], surfaces[j], places[i].inverse() @ places[j])
        if agreement.agreeing[0] + agreement.contradicting[0] < _LEAST_PATCHES:
            continue
        fit = normal_equations(surfaces[i], places[i], surfaces[j], places[j], COARSE)
        sums[i, j] = np.array([fit.square, fit.weight, agreement.contradicting[0], agreement.agreeing[0]], np.float64)
    misfits = []
    for k in places:
        own = sum((each for pair, each in sums.items() if k in pair), np.zeros(4))
        rest = sum((each for pair, each in sums.items() if k not in pair), np.zeros(4))
        if own[1] > 0 and rest[1] > 0:
            usual = (rest[0] + _SUPPOSED_PATCHES * _OFF**2) / (rest[1] + _SUPPOSED_PATCHES)
            worse = float(np.sqrt(own[0] / own[1] / usual))
            misfits.append(Misfit(k, float(own[2] / (own[2] + own[3])), worse))
    return max(misfits, key=lambda misfit: (misfit.finding is not None, misfit.times_worse), default=None)
