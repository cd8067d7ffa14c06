"""Pairs of samples of two surfaces at a pose: point-to-plane steps, the motions that they leave free, and what speaks
for the pose and against it.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Pose, cross
from calib.numerics import Bools, Floats, biweight_slope, shrunk_scatter
from calib.registration.sampled_surface import SampledSurface, cell_numbers, pair_samples
from calib.registration.surface_pair import MANY_SAMPLES, ScaledPair, SurfaceSide

LIKE = float(np.cos(np.radians(40.0)))  # least cosine of normals of surfaces that coincide
BESIDE = 1.5  # fine cells along the surface, beyond which there is no surface to compare with
_HELD, _OVER_NOISE = 1e-4, 0.3  # mean square of what holds a direction: at least, and over that of normals' noise


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """A motion of the second surface that changes nothing that can be measured, in the first one's frame."""

    direction: Floats
    """(3,): of the shift, or of the axis, of unit length."""
    through: Floats
    """(3,): a point of the axis."""
    turns: bool
    """Whether it is a rotation about the axis; otherwise a shift."""


@dataclass(frozen=True, eq=False)
class PairFit:
    """Pairs of samples at a pose: `points` (N, 3) of the second one moved, `normals` (N, 3) of both together, their
    halves `first_normals` and `second_normals`, and signed distances `residual` (N,) along them.
    """

    points: Floats
    normals: Floats
    first_normals: Floats
    second_normals: Floats
    residual: Floats

    @classmethod
    def at(
        cls, sides: ScaledPair, place: Pose, factor: float, sign: float, reach: float, some: SampledSurface
    ) -> "PairFit":
        """Pairs of `some` samples of the second surface whose distance is below `reach`."""
        moved, turned = place @ (factor * some.points), sign * place.rotate(some.normals)
        beside = BESIDE * sides.first.fine.cell
        pairs = pair_samples(sides.first.fine, sides.first.tree, moved, turned, float(np.hypot(reach, beside)))
        near = np.isfinite(pairs.apart) & (np.abs(pairs.along) < reach) & (pairs.aside < beside) & (pairs.cosine > LIKE)
        length = np.linalg.norm(pairs.own + turned, axis=1, keepdims=True)[near]
        return cls(moved[near], pairs.normals[near], pairs.own[near] / length, turned[near] / length, pairs.along[near])

    def covariance(self, centre: Floats, patch: float, *, with_scale: bool) -> Floats:
        """Covariance of a rotation vector about a centre (3,), a shift, and the logarithm of the scale, (6, 6) or
        (7, 7); errors may be alike across a `patch`. Infinite where nothing holds the pose.

        If the pose changes, so do the pairs: residuals follow the true surface, not the normals' noise. So what holds
        the pose is counted by both surfaces' normals, as in `free_motions`.
        """
        size, jacobian, by_first, by_second = self.jacobians(centre, with_scale=with_scale)
        cluster = np.unique(cell_numbers(self.points, patch, np.zeros(3)), return_inverse=True)[1]
        scatter = shrunk_scatter(jacobian, self.residual, cluster)
        held = (biweight_slope(self.residual)[:, None] * by_first).T @ by_second
        held += held.T
        if not (np.isfinite(scatter).all() and np.linalg.eigvalsh(held)[0] > 0):
            return np.full_like(held, np.inf)
        unit = np.array([size] * 3 + [1.0] * 3 + [size] * with_scale)
        bread = 2 * np.linalg.inv(held)
        covariance: Floats = bread @ scatter @ bread / np.outer(unit, unit)
        return covariance

    def jacobians(self, centre: Floats, *, with_scale: bool) -> tuple[float, Floats, Floats, Floats]:
        """The points' distance from a centre (3,), the unit of angles, and derivatives of the residuals by the motion
        (N, 6) or (N, 7): with the normals of both surfaces together, and with those of either.
        """
        arms = self.points - centre
        size = float(np.sqrt(np.mean(np.sum(arms**2, axis=1))))
        by_first, by_second = (
            position_jacobian(arms / size, 2 * normals, with_scale=with_scale)
            for normals in (self.first_normals, self.second_normals)
        )
        return size, (by_first + by_second) / 2, by_first, by_second

    def stepped(self, place: Pose, factor: float, weight: Floats, *, with_scale: bool) -> tuple[Pose, float]:
        """The pose and the scale after a weighted Gauss–Newton step."""
        centre = self.points.mean(axis=0)
        arms = self.points - centre
        size = max(float(np.sqrt(np.mean(np.sum(arms**2, axis=1)))), 1e-300)  # angles in lengths: in any unit the same
        jacobian = position_jacobian(arms / size, self.normals, with_scale=with_scale)
        matrix, gradient = (jacobian.T * weight) @ jacobian, jacobian.T @ (weight * self.residual)
        damping = 1e-6 * np.diag(np.diag(matrix)) + 1e-12 * np.trace(matrix) * np.eye(len(matrix))
        step = -np.linalg.solve(matrix + damping, gradient)
        turn = Pose.from_vector(np.append(step[:3] / size, np.zeros(3))).rotation
        grown = float(np.exp(np.clip(step[6] / size, -0.05, 0.05))) if with_scale else 1.0
        moved = grown * (turn @ (place.translation - centre)) + centre + step[3:6]
        return Pose(turn @ place.rotation, moved), grown * factor


def position_jacobian(arms: Floats, normals: Floats, *, with_scale: bool) -> Floats:
    """Derivatives (N, 6) or (N, 7) of distances along normals by rotation, shift and the logarithm of the scale."""
    columns = [cross(arms, normals), normals]
    if with_scale:
        columns.append(np.sum(arms * normals, axis=1, keepdims=True))
    return np.hstack(columns)


def free_motions(fit: PairFit, centre: Floats, shift: Floats, *, with_scale: bool) -> tuple[FreeMotion, ...]:
    """Motions that the pairs do not hold, from the eigenvectors of their normal matrix."""
    size, _, by_first, by_second = fit.jacobians(centre, with_scale=with_scale)
    held = (by_first.T @ by_second + by_second.T @ by_first) / (2 * len(by_first))
    noise = (by_first - by_second).T @ (by_first - by_second) / (4 * len(by_first))
    values, vectors = np.linalg.eigh(held)
    free = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value > max(_HELD, _OVER_NOISE * float(vector @ noise @ vector)):
            continue
        turn, move = vector[:3], vector[3:6]
        angle = float(np.linalg.norm(turn))
        if angle < 0.3:
            free.append(FreeMotion(move / max(float(np.linalg.norm(move)), 1e-12), centre + shift, turns=False))
        else:
            through = centre + size * np.cross(turn, move) / angle**2
            free.append(FreeMotion(turn / angle, through + shift, turns=True))
    return tuple(free)


_OPPOSITE_SIDE = 0.5  # cosine of normals, below which surfaces may be the two sides of something thin
_FREE = 3.0  # tolerances off the surface, from which a sample contradicts
_FAR = 3.0  # coarse cells, up to which it does
_LEAST_SHARE = 0.85  # of samples that agree, among those that say something
_LEAST_CELLS = 30.0  # coarse cells that agree
_LEAST_OVERLAP = 0.06
_RIVAL_CELLS, _RIVAL_OF_ALL = 0.5, 0.8  # of the best one's agreeing cells, that make another pose a rival
_SURE, _BY_CHANCE = 2.0, 0.3  # standard deviations; contradictions that are expected where there are none
_CLUSTER = 0.25  # coarse cells, whose contradiction counts as one
_SAME_TOLERANCES = 4.0
_PER_CONTRADICTION = 3.0  # agreeing cells


@dataclass(frozen=True, eq=False)
class SurfacePose:
    """X_first = pose @ (scale · X_second), and how well both surfaces fit."""

    pose: Pose
    scale: float
    overlap: tuple[float, float]
    """Shares of the first and the second surface's samples that coincide with the other one."""
    share: float
    """Of samples that coincide, among those that could."""
    agreeing: float
    """Size of what coincides, in coarse cells."""
    contradicting: float
    """Size of what contradicts, in coarse cells."""
    inside: float
    """Size of what coincides inside of the planes that bound either surface, in coarse cells."""
    is_mirrored: bool = False
    """Whether it is of the second surface's mirror image, x reversed: then it is no motion."""

    @property
    def shows_more_than_bounds(self) -> bool:
        """Whether so much coincides besides walls, or faces of a block, that it is no chance."""
        return self.inside > _LEAST_CELLS


def judge(sides: ScaledPair, place: Pose, sign: float, count: int = MANY_SAMPLES) -> SurfacePose:
    """The evidence for a pose, from `count` samples of both."""
    agreeing, against, inside, overlaps = 0.0, 0.0, 0.0, []
    ways = (
        (sides.second, sides.first, place),
        (sides.first, sides.second, place.inverse()),
    )
    for moving, still, pose in ways:
        some = moving.judged if count == MANY_SAMPLES else moving.fine.some(count)
        agree, contradict = _fates(some, still, pose, sign, sides)
        per_cell = sides.coarse**2 / _area_of_sample(some, moving.fine)
        agreeing += np.count_nonzero(agree) / per_cell / 2
        against += np.count_nonzero(contradict) / per_cell / 2
        inside += np.count_nonzero(moving.is_inside(some.points[agree])) / per_cell / 2
        overlaps.append(np.count_nonzero(agree) / len(some))
    share = agreeing / max(agreeing + against, 1e-9)
    middle = Pose(np.eye(3), sides.first.middle) @ place @ Pose(np.eye(3), -sides.second.middle)
    return SurfacePose(middle, sides.scale, (overlaps[1], overlaps[0]), share, agreeing, against, inside)


def _area_of_sample(some: SampledSurface, whole: SampledSurface) -> float:
    """Surface that one of `some` of the samples stands for."""
    return whole.cell**2 * len(whole) / len(some)


def _fates(some: SampledSurface, still: SurfaceSide, pose: Pose, sign: float, sides: ScaledPair) -> tuple[Bools, Bools]:
    """Which samples (N,) agree with a surface, and which contradict it."""
    moved, tolerance = pose @ some.points, sides.tolerance
    pairs = pair_samples(still.fine, still.tree, moved, sign * pose.rotate(some.normals), _FAR * sides.coarse)
    beside = np.isfinite(pairs.apart) & (pairs.aside < BESIDE * still.fine.cell)
    agree = beside & (np.abs(pairs.along) < tolerance) & (pairs.cosine > LIKE)
    against = beside & (np.abs(pairs.along) > _FREE * tolerance) & (pairs.cosine > _OPPOSITE_SIDE)
    if still.free is not None:
        against |= ~agree & (pairs.apart > _FREE * tolerance) & still.free.is_violated(moved, _FREE * tolerance)
    return agree, against


def worth(judged: SurfacePose) -> float:
    """What a pose explains, less what contradicts it, in coarse cells."""
    return judged.agreeing - _PER_CONTRADICTION * judged.contradicting


def holds(judged: SurfacePose) -> bool:
    """Whether a pose is explained by enough of both surfaces, and hardly contradicted."""
    return judged.share > _LEAST_SHARE and judged.agreeing > _LEAST_CELLS and max(judged.overlap) > _LEAST_OVERLAP


def needs_mirror_test(judged: SurfacePose) -> bool:
    """Whether a pose is hardly more than walls that coincide, or contradicted by more than chance."""
    by_chance = _BY_CHANCE + _SURE * np.sqrt(_BY_CHANCE) + 1.0
    return not judged.shows_more_than_bounds or bool(judged.contradicting / _CLUSTER > by_chance)


def is_rival(rival: SurfacePose, best: SurfacePose, *, is_all: bool = False) -> bool:
    """Whether a pose explains about as much as another or more.

    `is_all`: the other one explains all of a scan by all of a body, which the right pose does. One that leaves a fifth
    of the scan where the body has no surface is then no rival; of two views it may be right, as they need not overlap.
    """
    return rival.agreeing > (_RIVAL_OF_ALL if is_all else _RIVAL_CELLS) * best.agreeing


def surpasses(pose: SurfacePose, rival: SurfacePose) -> bool:
    """Whether a pose rivals another that is clearly more contradicted; or, both being as little contradicted, explains
    more of what lies between the planes that bound the surfaces: those alone coincide in several ways.
    """
    if not is_rival(pose, rival) or _is_less_contradicted(rival, pose):
        return False
    more = pose.shows_more_than_bounds and rival.inside < _RIVAL_CELLS * pose.inside
    return more or _is_less_contradicted(pose, rival)


def _is_less_contradicted(pose: SurfacePose, rival: SurfacePose) -> bool:
    """Whether clearly less contradicts a pose than another, by more than chance."""
    against, said = pose.contradicting / _CLUSTER, (pose.agreeing + pose.contradicting) / _CLUSTER
    expected = (against + _BY_CHANCE) * (rival.agreeing + rival.contradicting) / _CLUSTER / (said + _BY_CHANCE)
    most = expected + _SURE * np.sqrt(expected) + 1.0
    return bool(rival.contradicting / _CLUSTER > most)


def are_apart(pose: SurfacePose, rival: SurfacePose, points: Floats, tolerance: float) -> bool:
    """Whether two poses put points (N, 3) of the second surface in different places."""
    moved = pose.pose @ (pose.scale * points) - rival.pose @ (rival.scale * points)
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))) > _SAME_TOLERANCES * tolerance
