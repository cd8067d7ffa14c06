"""Registration of views without order or initial guess. Pairs suggest poses, and all members of a group judge them.

A group grows from the most certain pair, another one from the remaining views, and the largest is used. A view is tried
at every suggested pose relative to a member, and judged by all members: by agreement, and by violations of free space.
If a second pose of a view, or of it and all later ones, is nearly as good per patch, that ambiguity is reported.
Missing views are searched once more, longer, because they overlap little.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import IDENTITY, Pose
from calib.objects.joint import align
from calib.objects.patch_overlap import NARROW, OverlapEvidence, evidence, tolerance
from calib.objects.pose_search import are_about_the_same, suggested_poses
from calib.objects.view import PATCHES, ObjectView
from calib.registration import NO_OVERLAP, NOTHING_SEEN, UnregisteredStation, grow_groups, supposed_places

_SOME, _MORE = 250, 800  # patches to evaluate many poses, and the few best
_SETTLED, _LOOKED_AT, _KEPT = 16, 4, 3
_LEAST_SHARE, _LEAST_AGREEING = 0.75, 0.12  # share of the patches that could agree; share of all patches
_SURE_SHARE = 0.88  # for a pose by a group, or one of hundreds, some of which agree by chance
_FEWEST_AGREEING = 0.08  # share of all patches, before a pose is refined
_AS_GOOD = 0.93  # relative to the best pose

TOO_SMALL = FindingKind(
    "too-small",
    "A station is left out: too few of its pixels measure anything.",
    "Bring the rig nearer, so that the thing fills the picture, and expose longer or spray it if it is dark or shiny.",
    ("pixels",),
)
DOES_NOT_FIT = FindingKind(
    "does-not-fit",
    "A station of a thing is left out: wherever it fits one station, others see through or past its surface.",
    "Turn the thing less between stations, and let nothing of it bend or move.",
)


@dataclass(frozen=True, eq=False)
class Suggestion:
    """X_first = R X_second + t of a pair, and its evidence."""

    pose: Pose
    worth: float


@dataclass(frozen=True, eq=False)
class AlternativePose:
    """Another pose of a view that is almost as good: its rotation relative to the first one, and its evidence per
    patch.
    """

    view: int
    turn_deg: float
    worth: float


@dataclass(frozen=True, eq=False)
class _Group:
    """`places` of some views, and what the last of them is worth to the others."""

    places: dict[int, Pose]
    worth: float


@dataclass(frozen=True)
class _Judgement:
    """Of poses by several views: `worth` as of `OverlapEvidence`, patches that agree, and that could agree."""

    worth: float
    agreeing: int
    patches: int

    @property
    def rate(self) -> float:
        """Worth per patch: how much of the thing two views share depends on the pose."""
        return self.worth / max(1, self.patches)

    @property
    def holds(self) -> bool:
        """Whether the evidence against it does not prevail."""
        return self.agreeing > _SURE_SHARE * self.patches


@dataclass(frozen=True, eq=False)
class Registered:
    """`places` by view, X_common = R X_view + t, of the largest group; `alternatives` make it ambiguous."""

    places: Mapping[int, Pose]
    alternatives: tuple[AlternativePose, ...]
    left_out: tuple[UnregisteredStation, ...]


def register_views(views: Sequence[ObjectView | None], near: Mapping[int, Pose] | None = None) -> Registered:
    """Of one thing by one rig; in any order.

    `near`: places of some views that are nearly known, X_any = R X_view + t. Pairs of them are searched for only where
    their surfaces do not agree there.
    """
    seen = {k: view for k, view in enumerate(views) if view is not None}
    edges = {(i, j): _between(seen, i, j, near or {}) for i, j in combinations(seen, 2)}
    sure = {pair: suggestions for pair, suggestions in edges.items() if suggestions}
    left_out = [
        UnregisteredStation(k, Finding(NOTHING_SEEN, Severity.WARNING, "it shows only the static background"))
        for k in range(len(views))
        if k not in seen
    ]
    if not sure:
        return Registered({}, (), (*left_out, *(_unplaced(k, seen, sure) for k in seen)))
    places, alternatives = _largest_group(seen, sure)
    if missing := [k for k in seen if k not in places]:
        for i, j in combinations(seen, 2):
            if (i in missing or j in missing) and (suggestions := _suggested(seen[i], seen[j], thorough=True)):
                sure[i, j] = suggestions
        places, alternatives = _largest_group(seen, sure)
        missing = [k for k in seen if k not in places]
    left_out += [_unplaced(k, seen, sure) for k in missing]
    return Registered(dict(sorted(places.items())), tuple(alternatives), tuple(left_out))


def _unplaced(
    k: int, views: Mapping[int, ObjectView], edges: Mapping[tuple[int, int], Sequence[Suggestion]]
) -> UnregisteredStation:
    pixels = int(np.count_nonzero(np.isfinite(views[k].image.points[..., 2])))
    if pixels < PATCHES:
        message = f"only {pixels} of its pixels measure the thing"
        return UnregisteredStation(k, Finding(TOO_SMALL, Severity.WARNING, message, data={"pixels": float(pixels)}))
    if any(k in pair for pair in edges):
        message = "wherever it fits one station, others see through or past its surface"
        return UnregisteredStation(k, Finding(DOES_NOT_FIT, Severity.WARNING, message))
    return UnregisteredStation(k, Finding(NO_OVERLAP, Severity.WARNING, "its surface fits that of no other station"))


def _largest_group(
    views: Mapping[int, ObjectView], edges: Mapping[tuple[int, int], Sequence[Suggestion]]
) -> tuple[dict[int, Pose], list[AlternativePose]]:
    """Places of the largest group of views that judge each other, and what makes them ambiguous."""
    largest: tuple[dict[int, Pose], list[AlternativePose]] = {}, []
    left = dict(views)
    while between := {pair: found for pair, found in edges.items() if left.keys() >= {*pair}}:
        found = _grown(left, between)
        largest = max(largest, found, key=lambda group: len(group[0]))
        left = {k: view for k, view in left.items() if k not in found[0]}
        if len(left) <= len(largest[0]):
            break
    return largest


def _grown(
    views: Mapping[int, ObjectView], edges: Mapping[tuple[int, int], Sequence[Suggestion]]
) -> tuple[dict[int, Pose], list[AlternativePose]]:
    """Grow a group from the most certain pair, by all views that its members can judge."""
    first, _ = max(edges, key=lambda pair: edges[pair][0].worth)

    def extended(group: _Group) -> list[_Group]:
        tried = {k: _tried(views, edges, group.places, k) for k in views if k not in group.places}
        return [_Group({**group.places, k: some[0].pose}, some[0].worth) for k, some in tried.items() if some]

    def best(groups: Sequence[_Group]) -> list[_Group]:
        return [max(groups, key=lambda group: group.worth)] if groups else []

    places = grow_groups([_Group({first: IDENTITY}, 0.0)], extended, best)[0].places
    return places, [other for k in places for other in _alternatives(views, edges, places, k)]


def _alternatives(
    views: Mapping[int, ObjectView],
    edges: Mapping[tuple[int, int], Sequence[Suggestion]],
    places: Mapping[int, Pose],
    k: int,
) -> Iterator[AlternativePose]:
    """Other poses of a placed view, alone or with all that were placed after it, that little more speaks against."""
    order = list(places)
    for part in dict.fromkeys([(k,), tuple(order[order.index(k) :])]):  # of the last view they are one
        rest = {member: place for member, place in places.items() if member not in part}
        own = _judged(views, rest, {member: places[member] for member in part})
        for each in _tried(views, edges, rest, k):
            if are_about_the_same(each.pose, places[k], views[k].grain):
                continue
            step = each.pose @ places[k].inverse()
            moved = _judged(views, rest, {member: step @ places[member] for member in part})
            if moved.holds and moved.rate > _AS_GOOD * own.rate:
                turn_deg = float(np.degrees(places[k].angle_from(each.pose)))
                yield AlternativePose(k, turn_deg, moved.rate)


def _between(views: Mapping[int, ObjectView], i: int, j: int, near: Mapping[int, Pose]) -> list[Suggestion]:
    """The places of a pair that are worth following up, best first; only the known one if its surfaces agree there."""
    known = _worth_following(views[i], views[j], [near[i].inverse() @ near[j]]) if near.keys() >= {i, j} else []
    return known or _suggested(views[i], views[j])


def _suggested(first: ObjectView, second: ObjectView, *, thorough: bool = False) -> list[Suggestion]:
    """The places of a pair that are worth following up, best first, searched for."""
    return _worth_following(first, second, suggested_poses(first, second, thorough=thorough), thorough=thorough)


def _worth_following(
    first: ObjectView, second: ObjectView, poses: Sequence[Pose], *, thorough: bool = False
) -> list[Suggestion]:
    """Those of some places of a pair at which their surfaces agree, best first.

    Of the many of a `thorough` search, the right one is not the one that meets most, but that which little speaks
    against.
    """
    roughly = [evidence(first, second, pose, NARROW * first.grain, _SOME) for pose in poses]
    value = [_agreeing_share(overlap) if thorough else overlap.worth for overlap in roughly]
    rated = sorted(zip(value, range(len(poses)), strict=True), reverse=True)
    suggestions: list[Suggestion] = []
    for _, k in rated[:_SETTLED]:
        is_near = (are_about_the_same(poses[k], suggestion.pose, first.grain) for suggestion in suggestions)
        if len(suggestions) == _LOOKED_AT or any(is_near):
            continue
        pose = align(first, second, poses[k], (1.0, NARROW, NARROW), _MORE)
        closely = evidence(first, second, pose, tolerance(first, second), _MORE)
        least_share = _SURE_SHARE if thorough else _LEAST_SHARE
        if closely.share > least_share and closely.agreeing > _LEAST_AGREEING * 2 * _MORE:
            suggestions.append(Suggestion(pose, closely.worth))
    return sorted(suggestions, key=lambda suggestion: -suggestion.worth)[:_KEPT]


def _agreeing_share(overlap: OverlapEvidence) -> float:
    """The share of what could agree that does, if that is not just a few patches."""
    return overlap.share if overlap.agreeing > _FEWEST_AGREEING * 2 * _SOME else 0.0


def _tried(
    views: Mapping[int, ObjectView],
    edges: Mapping[tuple[int, int], Sequence[Suggestion]],
    places: Mapping[int, Pose],
    k: int,
) -> list[Suggestion]:
    """Possible poses of a view relative to the members, best first. Empty if there are none."""
    possible: list[Suggestion] = []
    for _, pose in supposed_places(edges, places, k):
        if any(are_about_the_same(pose, suggestion.pose, views[k].grain) for suggestion in possible):
            continue
        judged = _judged(views, places, {k: pose})
        if judged.holds:
            possible.append(Suggestion(pose, judged.worth))
    return sorted(possible, key=lambda suggestion: -suggestion.worth)


def _judged(views: Mapping[int, ObjectView], places: Mapping[int, Pose], part: Mapping[int, Pose]) -> _Judgement:
    """Evidence of all members for the poses of others."""
    evidences = [
        evidence(views[member], views[k], place.inverse() @ pose, NARROW * views[k].grain, _SOME)
        for member, place in places.items()
        for k, pose in part.items()
    ]
    agreeing = sum(overlap.agreeing for overlap in evidences)
    against = sum(overlap.against for overlap in evidences)
    return _Judgement(sum(overlap.worth for overlap in evidences), agreeing, agreeing + against)
