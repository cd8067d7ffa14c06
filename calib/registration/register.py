"""Registration of stations without an initial guess: from each station's view to the poses of all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import IDENTITY, Plane, Pose
from calib.registration.agreement import DECIDED_NATS, NATS_OF_POSE, compare_one
from calib.registration.alignment import normal_equations
from calib.registration.assembly import Assembly, Edges, assemble
from calib.registration.group_evidence import ANOTHER_ROOM, shared_planes, worst_misfit
from calib.registration.hypotheses import hypotheses, judged, refined
from calib.registration.range_view import StationView, Surfaces, surfaces_of

_MOST_ALTERNATIVES = 4
_LEAST_OVERLAP = 0.01
_MOST_CONTRADICTION = 0.1
_TOO_LITTLE = "it shares too little with the other stations to find its pose, or it shows another room"

NOTHING_SEEN = FindingKind(
    "nothing-seen",
    "A station is left out: it shows nothing, or only the static background of a thing.",
    "Check exposure and light. Turn a thing between stations: what is the same in all of them is taken for background.",
)
NO_OVERLAP = FindingKind(
    "no-overlap",
    "A station is left out: it shows too little of what another station shows.",
    "Add a station between it and the others, with more than a bare wall in it.",
)


@dataclass(frozen=True, eq=False)
class AlternativePlaces:
    """Other places of a group's stations that are not ruled out, and by how many nats they are behind."""

    places: tuple[Pose, ...]
    behind_nats: float


@dataclass(frozen=True, eq=False)
class Group:
    """Stations of one room.

    `places` by station, X_room = R X_camera + t, in the frame of the group's first station. `planes` in the room's
    frame; `plane_of`: for each station, the plane index of each of its labels, −1 for none. `alternatives`: equally
    likely solutions; with any, the group is ambiguous. `ahead_nats`: log likelihood ratio to the next solution
    evaluated, infinite without one.
    """

    stations: tuple[int, ...]
    places: tuple[Pose, ...]
    planes: tuple[Plane, ...]
    plane_of: tuple[tuple[int, ...], ...]
    alternatives: tuple[AlternativePlaces, ...]
    ahead_nats: float

    @property
    def ambiguous(self) -> bool:
        """Whether the stations could as well be elsewhere."""
        return len(self.alternatives) > 0


@dataclass(frozen=True, eq=False)
class Pair:
    """Two overlapping stations of one group, `first` < `second`.

    `overlap`: common share of their surfaces. `pose`: X_first = R X_second + t, from all stations together. `nats`:
    evidence of the overlap. `contradiction`: share of the other's surface that violates free space. `residual`: root
    mean square distance of the surfaces, relative to their depth. `closure`: displacement of the second station if only
    the first one determined it, in the unit of the points; large if the two share too little.
    """

    first: int
    second: int
    overlap: float
    pose: Pose
    nats: float
    contradiction: float
    residual: float
    closure: float


@dataclass(frozen=True)
class UnregisteredStation:
    """A station or view that belongs to no group."""

    station: int
    """Its number."""
    finding: Finding
    """Why; the message is a clause about it."""


@dataclass(frozen=True, eq=False)
class Registration:
    """`groups`, those of most stations first: two are two rooms, or two parts of one that no station connects."""

    groups: tuple[Group, ...]
    pairs: tuple[Pair, ...]
    left_out: tuple[UnregisteredStation, ...]


def register(stations: Sequence[StationView], of_another_rig: Mapping[int, Finding] | None = None) -> Registration:
    """Register stations of one rig, whose lengths have one unit, in any order.

    `of_another_rig`: stations known not to belong, by number, and why: such a station may nearly fit another,
    and would draw it away from the others.
    """
    reasons = {k: UnregisteredStation(k, finding) for k, finding in (of_another_rig or {}).items()}
    views = {k: view for k, view in enumerate(stations) if k not in reasons}
    surfaces = {k: surfaces_of(view) for k, view in views.items() if np.isfinite(view.points[..., 2]).any()}
    edges = {(i, j): hypotheses(surfaces[i], surfaces[j]) for i, j in combinations(surfaces, 2)}
    groups: list[Group] = []
    remaining, aside = list(surfaces), list[int]()
    while len(remaining) > 1:
        assemblies = assemble(surfaces, edges, remaining)
        if not assemblies:
            break
        best = assemblies[0]
        if best.loose:
            reasons.update({k: UnregisteredStation(k, _outlier(NO_OVERLAP, _TOO_LITTLE)) for k in best.loose})
            remaining = [k for k in remaining if k not in best.loose]
            aside += sorted(best.loose)
            continue
        worst = worst_misfit(surfaces, best.places)
        if worst is not None and worst.finding is not None:
            reasons[worst.station] = UnregisteredStation(worst.station, worst.finding)
            remaining.remove(worst.station)
            aside += [] if worst.of_another_shape else [worst.station]
            continue
        others = (assembly.whole or assembly for assembly in assemblies[1:])
        rivals = [rival for rival in others if rival.places.keys() == best.places.keys()]
        groups.append(_group(surfaces, best, rivals))
        remaining = [k for k in remaining + aside if k not in best.places]
        aside = []
    groups.sort(key=lambda group: -len(group.stations))
    pairs = [pair for group in groups for pair in _pairs(surfaces, group)]
    alone = [k for k in range(len(stations)) if not any(k in group.stations for group in groups)]
    left_out = tuple(reasons.get(k) or _reason(surfaces, edges, k) for k in alone)
    return Registration(tuple(groups), tuple(pairs), left_out)


def _group(surfaces: Mapping[int, Surfaces], best: Assembly, rivals: Sequence[Assembly]) -> Group:
    names = tuple(sorted(best.places))
    behind = [best.nats - rival.nats for rival in rivals]
    alternatives = [
        AlternativePlaces(tuple(each.places[k] for k in names), nats)
        for each, nats in zip(rivals, behind, strict=True)
        if nats < DECIDED_NATS
    ]
    planes = shared_planes(surfaces, best.places)
    return Group(
        names,
        tuple(best.places[k] for k in names),
        planes.planes,
        tuple(planes.plane_of[k] for k in names),
        tuple(alternatives[:_MOST_ALTERNATIVES]),
        min(behind, default=np.inf),
    )


def _pairs(surfaces: Mapping[int, Surfaces], group: Group) -> list[Pair]:
    pairs = []
    for (i, at), (j, there) in combinations(zip(group.stations, group.places, strict=True), 2):
        pose = at.inverse() @ there
        agreement = compare_one(surfaces[i], surfaces[j], pose)
        overlap = float(agreement.agreeing[0]) / (len(surfaces[i].patches.points) + len(surfaces[j].patches.points))
        if overlap < _LEAST_OVERLAP:
            continue
        fit = normal_equations(surfaces[j], pose, surfaces[i], IDENTITY, 0.01)
        alone = refined(surfaces[i], surfaces[j], pose)
        pairs.append(
            Pair(
                i,
                j,
                overlap,
                pose,
                judged(surfaces[i], surfaces[j], pose).nats,
                float(agreement.contradiction[0]),
                float(np.sqrt(fit.square / max(fit.weight, 1e-9))),
                float(np.linalg.norm(alone.translation - pose.translation)),
            )
        )
    return pairs


def _reason(surfaces: Mapping[int, Surfaces], edges: Edges, k: int) -> UnregisteredStation:
    """Why a station belongs to no group."""
    best = max(
        (each for pair, some in edges.items() if k in pair for each in some), key=lambda each: each.nats, default=None
    )
    if k not in surfaces:
        return UnregisteredStation(k, _outlier(NOTHING_SEEN, "it has no points"))
    if best is None or best.nats < NATS_OF_POSE / 2:
        return UnregisteredStation(k, _outlier(NO_OVERLAP, "it shows nothing that another station shows"))
    if best.contradiction > _MOST_CONTRADICTION:
        return UnregisteredStation(
            k,
            Finding(
                ANOTHER_ROOM,
                Severity.WARNING,
                f"wherever its surfaces fit, {best.contradiction:.0%} of them are in space that others saw as free: it "
                "is of another room, or something was moved",
                data={"looked_through_share": best.contradiction},
            ),
        )
    return UnregisteredStation(k, _outlier(NO_OVERLAP, _TOO_LITTLE))


def _outlier(kind: FindingKind, clause: str) -> Finding:
    return Finding(kind, Severity.WARNING, clause)
