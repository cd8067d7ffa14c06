"""Poses of several surfaces from those of pairs: groups that grow pair by pair, one estimate of all, and pairs that
contradict the others.

Residuals of pairs' poses are twists; their derivatives are taken at the estimate (Barfoot, "State estimation for
robotics", section 9.3).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import scipy

from calib.estimation import Term, add_up
from calib.geometry import IDENTITY, PER_POSE, Pose, cross_matrix
from calib.numerics import Floats, Quadratic, newton

_STEPS = 20
_CONVERGED = 1e-10
_BY_CHANCE = 1e-4  # probability of a χ² by chance, below which pairs contradict each other
_TURNED = np.radians(1.0)
_FLOOR = 1e-12  # of a variance, relative to the largest


class RelativePose(Protocol):
    """A supposed pose of one surface on another, X_first = R X_second + t."""

    @property
    def pose(self) -> Pose:
        """Of the surface with the larger number on the other."""


AnyRelativePose = TypeVar("AnyRelativePose", bound=RelativePose)
AnyGroup = TypeVar("AnyGroup")


def supposed_places(
    edges: Mapping[tuple[int, int], Sequence[AnyRelativePose]], places: Mapping[int, Pose], number: int
) -> Iterator[tuple[AnyRelativePose, Pose]]:
    """Where a surface may be, by the poses of its pairs with those that have a place, with what supposes it.

    `edges`: poses of pairs, whose smaller number comes first.
    """
    for member, place in places.items():
        for edge in edges.get((min(member, number), max(member, number)), ()):
            yield edge, place @ (edge.pose if member < number else edge.pose.inverse())


def grow_groups(
    begun: Sequence[AnyGroup],
    extended: Callable[[AnyGroup], Sequence[AnyGroup]],
    best: Callable[[Sequence[AnyGroup]], Sequence[AnyGroup]],
) -> list[AnyGroup]:
    """Groups that nothing extends any more, by a search that follows the `best` of those that were `extended` by one
    surface (beam search).
    """
    beam, finished = best(begun), list[AnyGroup]()
    while beam:
        longer = [(group, extended(group)) for group in beam]
        finished += [group for group, grown in longer if not grown]
        beam = best([group for _, grown in longer for group in grown])
    return finished


def couple_places(first: int, second: int, gradient: Floats, information: Floats, cost: float = 0.0) -> Term:
    """What a pair adds to the cost, by the twists of all places: of the first, by which gradient (6,) and information
    (6, 6) are, and of the second, which has the opposite effect.
    """
    sign = np.repeat([1.0, -1.0], PER_POSE)
    columns = np.concatenate([PER_POSE * number + np.arange(PER_POSE) for number in (first, second)])
    return Term(cost, sign * np.tile(gradient, 2), np.outer(sign, sign) * np.tile(information, (2, 2)), columns)


def adjust_places(
    places: Sequence[Pose],
    terms: Callable[[Sequence[Pose]], Sequence[Term]],
    *,
    steps: int,
    converged: float = 0.0,
    damping: float = 0.0,
) -> tuple[list[Pose], Quadratic]:
    """Places that lower the sum of terms most, by Newton's steps until no twist exceeds `converged`; the first stays.

    With the sum by all twists (6 n,), as it was before the last step. Nothing moves once there are no terms.
    """
    now, free = list(places), np.arange(PER_POSE, PER_POSE * len(places))
    total = add_up(PER_POSE * len(now), ())
    for _ in range(steps):
        total = add_up(PER_POSE * len(now), some := terms(now))
        if not some:
            break
        twists = newton(total, free, damping)[0].reshape(-1, PER_POSE)
        now = [Pose.from_vector(twist) @ place for twist, place in zip(twists, now, strict=True)]
        if np.abs(twists).max() < converged:
            break
    return now, total


@dataclass(frozen=True, eq=False)
class PairPose:
    """X_first = pose @ X_second of two surfaces, by their numbers."""

    first: int
    second: int
    pose: Pose
    centre: Floats
    """(3,): the point of the first one's frame that the rotation vector of the covariance is about."""
    covariance: Floats
    """(6, 6): of a rotation vector and a shift, in the first one's frame."""
    tolerance: float = 0.0
    """Distance below which two poses are the same: calibrations deform clouds by that much."""

    @property
    def information(self) -> Floats:
        """(6, 6): inverse covariance of the twist in the first one's frame."""
        about = np.eye(PER_POSE)
        about[3:, :3] = cross_matrix(self.centre)
        twist = about @ self.covariance @ about.T
        information: Floats = np.asarray(np.linalg.inv(twist + _FLOOR * np.diag(np.diag(twist))), np.float64)
        return information


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Places of the surfaces that pairs connect with the first of them, X_first = R X + t."""

    places: Mapping[int, Pose]
    covariance: Floats
    """(6 n, 6 n): of twists in the first one's frame, in the order of `places`; zero for the first."""
    chi2: float
    freedom: int
    """Number of redundant measurements."""
    dropped: tuple[PairPose, ...]
    """Pairs that contradict the others."""
    contradict: bool
    """Whether pairs that are left contradict each other, so that no place is certain."""

    def sigmas(self, number: int, point: Floats) -> tuple[float, float]:
        """Standard deviations of a surface's rotation, in radians, and of its point (3,), in the first one's frame."""
        at = PER_POSE * list(self.places).index(number)
        own = self.covariance[at : at + PER_POSE, at : at + PER_POSE]
        by_twist = np.hstack([-cross_matrix(point), np.eye(3)])
        turn, moved = np.trace(own[:3, :3]), np.trace(by_twist @ own @ by_twist.T)
        return float(np.sqrt(max(turn, 0.0))), float(np.sqrt(max(moved, 0.0)))


def solve_pose_graph(pairs: Sequence[PairPose], root: int) -> PoseGraph:
    """Places of all that is connected with the `root`. A pair that contradicts the others is dropped, if a rest of
    pairs that agree still connects everything.
    """
    kept, dropped = list(pairs), list[PairPose]()
    while True:
        places = _connected(kept, root)
        own = [pair for pair in kept if pair.first in places]
        solved, covariance, parts = _solved(own, places)
        freedom = PER_POSE * (len(own) - len(places) + 1)
        chi2 = float(np.sum(parts))
        is_unlikely = freedom > 0 and chi2 > float(scipy.special.chdtri(freedom, _BY_CHANCE))
        contradict = is_unlikely and any(_is_off(pair, solved) for pair in own)
        worse = _worst(own, parts, places, root) if contradict else None
        if worse is None:
            scale = max(1.0, chi2 / freedom) if freedom else 1.0
            return PoseGraph(solved, scale * covariance, chi2, freedom, tuple(dropped), contradict)
        kept = [pair for pair in kept if pair is not worse]
        dropped.append(worse)


def _is_off(pair: PairPose, places: Mapping[int, Pose]) -> bool:
    """Whether a pair's pose is visibly another one than that of the places."""
    change = places[pair.first].inverse() @ places[pair.second] @ pair.pose.inverse()
    moved = float(np.linalg.norm(change @ pair.centre - pair.centre))
    return moved > pair.tolerance or float(change.angle) > _TURNED


def _connected(pairs: Sequence[PairPose], root: int) -> dict[int, Pose]:
    """Places along the pairs that are known best."""
    places = {root: IDENTITY}
    ordered = sorted(pairs, key=lambda pair: float(np.trace(pair.covariance[3:, 3:])))
    while True:
        step = next((pair for pair in ordered if (pair.first in places) != (pair.second in places)), None)
        if step is None:
            return places
        if step.first in places:
            places[step.second] = places[step.first] @ step.pose
        else:
            places[step.first] = places[step.second] @ step.pose.inverse()


def _solved(pairs: Sequence[PairPose], places: Mapping[int, Pose]) -> tuple[dict[int, Pose], Floats, Floats]:
    """Places, their covariance, and χ² of each pair."""
    names = list(places)
    chi2 = np.zeros(len(pairs))

    def terms(now: Sequence[Pose]) -> list[Term]:
        made = []
        for number, pair in enumerate(pairs):
            first, second = names.index(pair.first), names.index(pair.second)
            residual = (now[first].inverse() @ now[second] @ pair.pose.inverse()).log()
            to_first = now[first].inverse().adjoint
            weighted, chi2[number] = to_first.T @ pair.information, residual @ pair.information @ residual
            made.append(couple_places(second, first, weighted @ residual, weighted @ to_first, float(chi2[number])))
        return made

    solved, total = adjust_places(list(places.values()), terms, steps=_STEPS, converged=_CONVERGED)
    covariance = np.zeros_like(total.information)
    covariance[PER_POSE:, PER_POSE:] = np.linalg.inv(total.information[PER_POSE:, PER_POSE:])
    return dict(zip(names, solved, strict=True)), covariance, chi2


def _worst(pairs: Sequence[PairPose], parts: Floats, places: Mapping[int, Pose], root: int) -> PairPose | None:
    """The pair without which the others agree best, and still connect as much; None if there is none, or if so few are
    left that nothing tells which of them is wrong.
    """
    best: tuple[float, PairPose] | None = None
    for number in np.argsort(-parts):
        rest = [pair for k, pair in enumerate(pairs) if k != number]
        without = _connected(rest, root)
        freedom = PER_POSE * (len(rest) - len(without) + 1)
        if len(without) < len(places) or freedom <= 0:
            continue
        chi2 = float(np.sum(_solved(rest, without)[2]))
        if best is None or chi2 < best[0]:
            best = chi2, pairs[number]
    return None if best is None else best[1]
