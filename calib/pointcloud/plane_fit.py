"""Robust least-squares plane through points, with its covariance."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Plane
from calib.numerics import Floats, Ints, biweight, influence_on, robust_covariance

_STEPS = 20
_CONVERGED = 1e-10


@dataclass(frozen=True, eq=False)
class FittedPlane(Plane):
    """A plane that faces the origin, so that its offset is negative, with the covariance of its parameters.

    They are two tilts and a shift around `centre`: the normal becomes `normal` − tilt · `tangents`, and the plane moves
    by the shift along it.
    """

    centre: Floats
    """(3,): the points' weighted mean."""
    tangents: Floats
    """(2, 3): directions in the plane."""
    jacobian: Floats
    """(N, 3): derivatives of the plane's height at each point by the parameters."""
    covariance: Floats
    """(3, 3): of the parameters."""
    residual: Floats
    """(N,): signed distances of the points, positive on the origin's side."""

    @property
    def influence(self) -> Floats:
        """Derivatives (3, N) of the parameters by the points' distances."""
        return influence_on(self.jacobian, self.residual)


def fit_plane(points: Floats, cluster: Ints) -> FittedPlane:
    """Minimise the points' (N, 3) distances from the plane with Tukey's weights.

    `cluster` (N,): labels from 0 of points whose errors may correlate. Raises ValueError for fewer than three points,
    or if they are collinear.
    """
    if len(points) < 3:
        raise ValueError(f"a plane needs three points, found {len(points)}")
    middle, weight, normal = points.mean(axis=0), np.ones(len(points)), np.zeros(3)
    rows = np.ascontiguousarray((points - middle).T)  # (3, N): several times as fast as (N, 3)
    for _ in range(_STEPS):
        centre = rows @ weight / weight.sum()
        from_centre = rows - centre[:, None]
        spread, axes = np.linalg.eigh((weight * from_centre) @ from_centre.T)
        if not spread[1] > 1e-12 * spread[2]:
            raise ValueError("the points are in a line, which many planes go through")
        previous, normal = normal, axes[:, 0]
        residual = normal @ from_centre
        weight = biweight(residual)
        if 1 - abs(previous @ normal) < _CONVERGED**2:
            break
    # In the plane's own axes the height changes by a tilt about either of them, or by a shift.
    jacobian = np.concatenate([axes[:, 1:].T @ from_centre, np.ones((1, len(points)))]).T
    centre += middle
    covariance = robust_covariance(jacobian, residual, cluster)
    offset = float(normal @ centre)
    sign = -1.0 if offset > 0 else 1.0
    return FittedPlane(sign * normal, sign * offset, centre, axes[:, 1:].T, jacobian, covariance, sign * residual)


def dihedral_angle_rad(first: FittedPlane, second: FittedPlane) -> tuple[float, float]:
    """The angle between two faces, on the side of the origin, and its standard deviation, in radians.

    In a room that is the angle of its corner; the angle of a box seen from outside is 2π minus this.
    """
    variance = sum(
        gradient @ plane.covariance @ gradient
        for plane, gradient in zip((first, second), dihedral_gradients(first, second), strict=True)
    )
    cosine = float(np.clip(first.normal @ second.normal, -1, 1))
    return float(np.pi - np.arccos(cosine)), float(np.sqrt(variance))


def dihedral_gradients(first: FittedPlane, second: FittedPlane) -> tuple[Floats, Floats]:
    """Derivatives (3,) of the angle between two faces by the parameters of either."""
    cosine = float(np.clip(first.normal @ second.normal, -1, 1))
    sine = max(float(np.sqrt(1 - cosine**2)), 1e-12)
    by_first, by_second = (
        np.append(-plane.tangents @ neighbour.normal / sine, 0.0)
        for plane, neighbour in ((first, second), (second, first))
    )
    return by_first, by_second
