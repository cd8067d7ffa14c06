"""Suggested relative poses of pairs → poses of whole groups of stations, decided by all loops together.

Several groups grow in parallel, station by station (beam search). A station is tried at every suggested pose relative
to a member, refined against all members, and judged by all of them: by agreement, and by violations of free space.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry import IDENTITY, Pose
from calib.numerics import Bools, distinct
from calib.registration.agreement import (
    COARSE,
    DECIDED_NATS,
    FINE,
    NATS_OF_POSE,
    compare,
    compare_one,
    gain,
    nats_of_place,
)
from calib.registration.alignment import align, align_jointly
from calib.registration.group_evidence import firmly_connected
from calib.registration.hypotheses import Hypothesis
from calib.registration.pose_graph import grow_groups, supposed_places
from calib.registration.range_view import Surfaces

_BEAM, _TRIED, _SETTLED = 12, 60, 3
_COMPARED = 4
_PATCHES = 400
_SAME_TURN, _SAME_PLACE = np.radians(4.0), 0.06

Edges = Mapping[tuple[int, int], Sequence[Hypothesis]]


@dataclass(frozen=True)
class Assembly:
    """`places` by station, in the order of addition, in the frame of the one with the smallest number; and their
    evidence in nats.

    `whole`: with further stations that fit, but with weak evidence.
    """

    places: dict[int, Pose]
    nats: float
    whole: "Assembly | None" = None

    @property
    def loose(self) -> set[int]:
        """Stations that were cut off."""
        return self.whole.places.keys() - self.places.keys() if self.whole else set()

    def like(self, assembly: "Assembly", size: float) -> bool:
        """Whether the same stations are at the same places, relative to each other."""
        if self.places.keys() != assembly.places.keys():
            return False
        first = min(self.places)
        here, there = (each.places[first].inverse() for each in (self, assembly))
        for k in self.places:
            off = (here @ self.places[k]).inverse() @ there @ assembly.places[k]
            if not off.is_near(IDENTITY, _SAME_TURN, size):
                return False
        return True


def assemble(surfaces: Mapping[int, Surfaces], edges: Edges, stations: Sequence[int]) -> list[Assembly]:
    """Groups among some stations, first those with the largest total evidence, together with that of the group of the
    rest.

    So a station stays where it is needed, and separate rooms are recognised. Empty if no two stations belong together.
    """
    groups = _groups(surfaces, edges, stations)
    total: dict[frozenset[int], float] = {}
    for group in groups:
        names = frozenset(group.places)
        if names not in total and len(total) < _COMPARED:
            rest = _groups(surfaces, edges, [k for k in stations if k not in names])
            total[names] = group.nats + (max(0.0, rest[0].nats - DECIDED_NATS) if rest else 0.0)
    return sorted(groups, key=lambda group: -total.get(frozenset(group.places), -np.inf))


def _groups(surfaces: Mapping[int, Surfaces], edges: Edges, stations: Sequence[int]) -> list[Assembly]:
    """The likeliest first."""
    if len(stations) < 2:
        return []
    size = _SAME_PLACE * float(np.median([surfaces[k].distance for k in stations]))
    begun = [
        Assembly({i: IDENTITY, j: each.pose}, each.nats - NATS_OF_POSE)
        for (i, j), some in edges.items()
        if i in stations and j in stations
        for each in some
    ]
    whole = grow_groups(
        begun, lambda group: _grown(surfaces, edges, stations, group), lambda groups: _distinct(groups, size)
    )
    finished = _distinct([group for group in whole if group.nats > DECIDED_NATS], size)
    together = _distinct([_together(surfaces, assembly) for assembly in finished], size)
    return sorted((_without_loose(surfaces, assembly) for assembly in together), key=lambda assembly: -assembly.nats)


def _distinct(assemblies: Sequence[Assembly], size: float) -> list[Assembly]:
    """The best, each unlike the better ones."""
    ordered = sorted(assemblies, key=lambda assembly: -assembly.nats)

    def are_like(k: int) -> Bools:
        return np.array([assembly.like(ordered[k], size) for assembly in ordered])

    return [ordered[k] for k in distinct(len(ordered), are_like, _BEAM)]


def _grown(surfaces: Mapping[int, Surfaces], edges: Edges, stations: Sequence[int], group: Assembly) -> list[Assembly]:
    """The group with one station more, at its likeliest places."""
    tried = [
        (edge.nats, k, place)
        for k in stations
        if k not in group.places
        for edge, place in supposed_places(edges, group.places, k)
    ]
    tried.sort(key=lambda supposed: -supposed[0])
    worth = [(_coarsely(surfaces, group, k, place), k, place) for _, k, place in tried[:_TRIED]]
    worth.sort(key=lambda each: -each[0])
    grown: list[Assembly] = []
    count: dict[int, int] = {}
    for _, k, place in worth:
        if count.get(k, 0) == _SETTLED or any(
            k in more.places and more.places[k].is_near(place, _SAME_TURN, _SAME_PLACE * surfaces[k].distance)
            for more in grown
        ):
            continue
        count[k] = count.get(k, 0) + 1
        members = [(surfaces[member], at) for member, at in group.places.items()]
        place = align(surfaces[k], place, members, (COARSE, FINE), _PATCHES)
        more = gain_of(surfaces, group.places, k, place)
        if more > DECIDED_NATS:
            grown.append(Assembly({**group.places, k: place}, group.nats + more))
    return grown


def gain_of(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose], k: int, place: Pose) -> float:
    """Evidence in nats for a station at a pose relative to others."""
    poses = [at.inverse() @ place for at in places.values()]
    agreements = [compare_one(surfaces[member], surfaces[k], pose) for member, pose in zip(places, poses, strict=True)]
    return nats_of_place(agreements, poses)


def _coarsely(surfaces: Mapping[int, Surfaces], group: Assembly, k: int, place: Pose) -> float:
    """Evidence for a station at a pose relative to a group, from some of the patches, before refinement."""
    agreements = []
    for member, at in group.places.items():
        pose = at.inverse() @ place
        agreements.append(compare(surfaces[member], surfaces[k], pose[None], COARSE, _PATCHES))
    return float(gain(agreements, len(surfaces[k].patches.points) / _PATCHES)[0])


def _together(surfaces: Mapping[int, Surfaces], group: Assembly) -> Assembly:
    """All stations moved until they fit best together, and judged again."""
    members = dict(sorted(group.places.items()))
    first = next(iter(members.values())).inverse()
    places = align_jointly({k: surfaces[k] for k in members}, {k: first @ place for k, place in members.items()})
    places = {k: places[k] for k in group.places}
    return Assembly(places, _nats(surfaces, places))


def _without_loose(surfaces: Mapping[int, Surfaces], group: Assembly) -> Assembly:
    """The group with only its firmly connected stations."""
    held = firmly_connected(surfaces, group.places)
    if len(held) == len(group.places):
        return group
    first = held[min(held)].inverse()
    places = {k: first @ place for k, place in held.items()}
    return Assembly(places, _nats(surfaces, places), group)


def _nats(surfaces: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> float:
    """What a group is worth, station after station in the order of `places`."""
    names = list(places)
    return sum(gain_of(surfaces, {m: places[m] for m in names[:n]}, k, places[k]) for n, k in enumerate(names[1:], 1))
