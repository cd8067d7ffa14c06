"""Poses of several surfaces from those of pairs: weighted least squares on SE(3), and pairs that contradict the others.

Residuals are twists; their derivatives are taken at the estimate (Barfoot, "State estimation for robotics", section
9.3).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.estimation import add_up
from calib.geometry import IDENTITY, PER_POSE, Pose, cross_matrix
from calib.numerics import Floats
from calib.registration.alignment import couple_places, step_places

_STEPS = 20
_CONVERGED = 1e-10
_BY_CHANCE = 1e-4  # probability of a χ² by chance, below which pairs contradict each other
_TURNED = np.radians(1.0)
_FLOOR = 1e-12  # of a variance, relative to the largest


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
    now, names = dict(places), list(places)
    count = len(names)
    covariance = np.zeros((PER_POSE * count, PER_POSE * count))
    if count == 1:
        return now, covariance, np.zeros(0)
    for _ in range(_STEPS):
        terms = []
        for pair in pairs:
            residual = (now[pair.first].inverse() @ now[pair.second] @ pair.pose.inverse()).log()
            to_first = now[pair.first].inverse().adjoint
            weighted, cost = to_first.T @ pair.information, float(residual @ pair.information @ residual)
            numbers = names.index(pair.second), names.index(pair.first)
            terms.append(couple_places(*numbers, weighted @ residual, weighted @ to_first, cost))
        total = add_up(PER_POSE * count, terms)
        twists = step_places(total)
        for name, twist in zip(names, twists, strict=True):
            now[name] = Pose.exp(twist) @ now[name]
        if np.abs(twists).max() < _CONVERGED:
            break
    covariance[PER_POSE:, PER_POSE:] = np.linalg.inv(total.information[PER_POSE:, PER_POSE:])
    return now, covariance, np.array([term.cost for term in terms])


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
