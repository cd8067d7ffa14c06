"""Which plane segments of a group's stations are one plane of the room.

Two segments are if patches of one, seen from the other's camera, lie on the other. A chain of such pairs forms a plane.
It has one segment per station, because planes that are separate there stay separate.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry import Plane, Pose
from calib.numerics import Floats
from calib.registration.agreement import compare_one
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
