"""Point-to-plane steps between two sampled surfaces, and the motions that they leave free."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Pose, cross
from calib.numerics import Floats
from calib.registration.sampled_surface import SampledSurface, pair_samples
from calib.registration.surface_pair import ScaledPair

LIKE = float(np.cos(np.radians(40.0)))  # least cosine of normals of surfaces that coincide
BESIDE = 1.5  # fine cells along the surface, beyond which there is no surface to compare with
_HELD, _OVER_NOISE = (
    1e-4,
    0.3,
)  # mean square of what holds a direction: at least, and relative to that of normals' noise


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
    arms = fit.points - centre
    size = float(np.sqrt(np.mean(np.sum(arms**2, axis=1))))
    one, other = (
        2 * position_jacobian(arms / size, normals, with_scale=with_scale)
        for normals in (fit.first_normals, fit.second_normals)
    )
    held = (one.T @ other + other.T @ one) / (2 * len(arms))
    noise = (one - other).T @ (one - other) / (4 * len(arms))
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
