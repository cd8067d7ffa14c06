"""Evidence for and against a pose of one sampled surface on another."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Pose
from calib.numerics import Floats
from calib.registration.sampled_surface import SampledSurface, pair_samples
from calib.registration.surface_fit import BESIDE, LIKE
from calib.registration.surface_pair import MANY_SAMPLES, ScaledPair, SurfaceSide

_OPPOSITE_SIDE = 0.5  # cosine of normals, below which surfaces may be the two sides of something thin
_FREE = 3.0  # tolerances off the surface, from which a sample contradicts
_FAR = 3.0  # coarse cells, up to which it does
_LEAST_SHARE = 0.85  # of samples that agree, among those that say something
_LEAST_CELLS = 30.0  # coarse cells that agree
_LEAST_OVERLAP = 0.06
RIVAL_CELLS = 0.5  # of the best one's agreeing cells, that make another pose a rival
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


def judge(sides: ScaledPair, place: Pose, sign: float, count: int = MANY_SAMPLES) -> SurfacePose:
    """The evidence for a pose, from `count` samples of both."""
    agreeing, against, overlaps = 0.0, 0.0, []
    ways = (
        (sides.second, sides.first, place),
        (sides.first, sides.second, place.inverse()),
    )
    for moving, still, pose in ways:
        some = moving.judged if count == MANY_SAMPLES else moving.fine.some(count)
        agree, contradict = _fates(some, still, pose, sign, sides)
        per_cell = sides.coarse**2 / _area_of_sample(some, moving.fine)
        agreeing += agree / per_cell / 2
        against += contradict / per_cell / 2
        overlaps.append(agree / len(some))
    share = agreeing / max(agreeing + against, 1e-9)
    middle = Pose(np.eye(3), sides.first.middle) @ place @ Pose(np.eye(3), -sides.second.middle)
    return SurfacePose(middle, sides.scale, (overlaps[1], overlaps[0]), share, agreeing, against)


def _area_of_sample(some: SampledSurface, whole: SampledSurface) -> float:
    """Surface that one of `some` of the samples stands for."""
    return whole.cell**2 * len(whole) / len(some)


def _fates(some: SampledSurface, still: SurfaceSide, pose: Pose, sign: float, sides: ScaledPair) -> tuple[int, int]:
    """How many samples agree with a surface, and how many contradict it."""
    moved, tolerance = pose @ some.points, sides.tolerance
    pairs = pair_samples(still.fine, still.tree, moved, sign * pose.rotate(some.normals), _FAR * sides.coarse)
    beside = np.isfinite(pairs.apart) & (pairs.aside < BESIDE * still.fine.cell)
    agree = beside & (np.abs(pairs.along) < tolerance) & (pairs.cosine > LIKE)
    against = beside & (np.abs(pairs.along) > _FREE * tolerance) & (pairs.cosine > _OPPOSITE_SIDE)
    if still.free is not None:
        against |= ~agree & (pairs.apart > _FREE * tolerance) & still.free.is_violated(moved, _FREE * tolerance)
    return int(np.count_nonzero(agree)), int(np.count_nonzero(against))


def worth(judged: SurfacePose) -> float:
    """What a pose explains, less what contradicts it, in coarse cells."""
    return judged.agreeing - _PER_CONTRADICTION * judged.contradicting


def holds(judged: SurfacePose) -> bool:
    """Whether a pose is explained by enough of both surfaces, and hardly contradicted."""
    return judged.share > _LEAST_SHARE and judged.agreeing > _LEAST_CELLS and max(judged.overlap) > _LEAST_OVERLAP


def surpasses(one: SurfacePose, other: SurfacePose) -> bool:
    """Whether clearly less contradicts a pose than another, which does not explain much more."""
    against, said = one.contradicting / _CLUSTER, (one.agreeing + one.contradicting) / _CLUSTER
    expected = (against + _BY_CHANCE) * (other.agreeing + other.contradicting) / _CLUSTER / (said + _BY_CHANCE)
    most = expected + _SURE * np.sqrt(expected) + 1.0
    return one.agreeing > RIVAL_CELLS * other.agreeing and other.contradicting / _CLUSTER > most


def are_apart(one: SurfacePose, other: SurfacePose, points: Floats, tolerance: float) -> bool:
    """Whether two poses put points (N, 3) of the second surface in different places."""
    moved = one.pose @ (one.scale * points) - other.pose @ (other.scale * points)
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))) > _SAME_TOLERANCES * tolerance
