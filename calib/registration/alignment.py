"""Point-to-plane registration by projection: each patch is compared with the surface in the same direction of the other
camera.

Chen and Medioni, "Object modelling by registration of multiple range images", 1992; the closest point is searched along
the other camera's ray (Blais and Levine 1995), without a search tree. Matching keypoints of the pictures are included.
Poses move by twists of the room's frame: a rotation ω and a translation v take X to X + ω × X + v.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calib.estimation import Term
from calib.geometry import Pose, cross_matrix
from calib.numerics import Floats
from calib.registration.agreement import FINE, GATES
from calib.registration.keypoints import match_keypoints
from calib.registration.pose_graph import adjust_places, couple_places
from calib.registration.projection import add_patches, step_pose
from calib.registration.range_view import Surfaces

# Undetermined directions of a station do not move: damping relative to the determined ones.
_DAMPING = 1e-3
_STEPS = 12
_CONVERGED = 1e-6


@dataclass(frozen=True)
class NormalEquations:
    """Of the twist of one station against another: `matrix` (6, 6), `gradient` (6,), sums over `count` patches of
    squared relative distances, whose weighted sum is `square`; `weight` is the sum of the weights. Of keypoints there
    is something in the first two only.
    """

    matrix: Floats
    gradient: Floats
    square: float
    weight: float
    count: int


def normal_equations(
    moving: Surfaces,
    place: Pose,
    still: Surfaces,
    still_place: Pose,
    tolerance: float,
    patches: int | None = None,
    centre: Floats | None = None,
) -> NormalEquations:
    """Normal equations for the twist of `moving`, from the patches of both; for `still`, the gradient changes its sign.

    `tolerance`: relative to the depth, beyond the noise. `centre` (3,): of the rotation, the origin by default.
    """
    centre = np.zeros(3) if centre is None else centre
    matrix, pulls = np.zeros((6, 6)), np.zeros((2, 6))
    noise, pose = 3 * (moving.noise + still.noise), still_place.inverse() @ place
    square, weight, count = 0.0, 0.0, 0
    for one, other, at, to_other, pull in (
        (moving, still, still_place, pose, pulls[0]),
        (still, moving, place, pose.inverse(), pulls[1]),
    ):
        turn, room = np.ascontiguousarray(to_other.rotation), np.ascontiguousarray(at.rotation)
        some, shift, arm = one.patches.first(patches), to_other.translation, at.translation - centre
        sums = add_patches(other.image, some, turn, shift, GATES, tolerance, noise, room, arm, matrix, pull)
        square, weight, count = square + sums[1], weight + sums[2], count + sums[3]
    keypoints = _of_keypoints(moving, place, still, still_place, tolerance, centre)
    matrix, gradient = matrix + keypoints[:, :6], pulls[0] - pulls[1] + keypoints[:, 6]
    return NormalEquations(matrix, gradient, square, weight, count)


def _of_keypoints(
    moving: Surfaces, place: Pose, still: Surfaces, still_place: Pose, tolerance: float, centre: Floats
) -> Floats:
    """Normal matrix and gradient (6, 7) of matching keypoints that should coincide, with Tukey's weights."""
    own, matching = match_keypoints(moving.keypoints, still.keypoints)
    if not len(own):
        return np.zeros((6, 7))
    points = place @ moving.keypoints.points[own]
    off = points - still_place @ still.keypoints.points[matching]
    depth = moving.keypoints.points[own, 2]
    relative = np.linalg.norm(off, axis=1) / (tolerance * depth)
    near = relative < 1
    if not near.any():
        return np.zeros((6, 7))
    points, off = points[near], off[near]
    weight = ((1 - relative[near] ** 2) / depth[near]) ** 2
    by_twist = np.concatenate([cross_matrix(points - centre), np.broadcast_to(np.eye(3), (len(off), 3, 3))], 1)
    sums = np.empty((6, 7))
    sums[:, :6] = np.einsum("n,nia,nja->ij", weight, by_twist, by_twist)
    sums[:, 6] = np.einsum("n,nia,na->i", weight, by_twist, off)
    return sums


def align(
    moving: Surfaces,
    place: Pose,
    fixed: Sequence[tuple[Surfaces, Pose]],
    tolerances: Sequence[float],
    patches: int | None = None,
) -> Pose:
    """The pose of one station that best fits the others, which are fixed, with one tolerance after the other."""
    for tolerance in tolerances:
        for _ in range(_STEPS):
            centre = place.translation
            equations = [
                normal_equations(moving, place, still, still_place, tolerance, patches, centre)
                for still, still_place in fixed
            ]
            matrix: Floats = np.sum([pair.matrix for pair in equations], axis=0)
            gradient: Floats = np.sum([pair.gradient for pair in equations], axis=0)
            place = Pose(place.rotation.copy(), centre.copy())
            change = step_pose(matrix, gradient, _DAMPING / 3, centre, place.rotation, place.translation)
            if change < _CONVERGED * max(1.0, moving.distance):
                break
    return place


def align_jointly(stations: Mapping[int, Surfaces], places: Mapping[int, Pose]) -> dict[int, Pose]:
    """All places at once; the first station's stays."""
    surfaces = [stations[name] for name in places]
    pairs = list(combinations(range(len(surfaces)), 2))

    def terms(now: Sequence[Pose]) -> list[Term]:
        nonlocal pairs
        fits = [normal_equations(surfaces[a], now[a], surfaces[b], now[b], FINE) for a, b in pairs]
        meeting = [(pair, fit) for pair, fit in zip(pairs, fits, strict=True) if fit.count > 0]
        pairs = [pair for pair, _ in meeting]
        return [couple_places(*pair, fit.gradient, fit.matrix) for pair, fit in meeting]

    converged = _CONVERGED * surfaces[0].distance
    adjusted, _ = adjust_places(list(places.values()), terms, steps=_STEPS, converged=converged, damping=_DAMPING)
    return dict(zip(places, adjusted, strict=True))
