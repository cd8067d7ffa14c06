"""A sphere through points: geometric least squares that outliers do not sway, with its covariance."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Ints, biweight, robust_covariance
from calib.numerics.robust_statistics import influence_on

_STEPS = 50
_CONVERGED = 1e-10


@dataclass(frozen=True)
class Sphere:
    """`centre` (3,) and `radius`, in the unit of the points.

    `covariance` (4, 4) of centre and radius; the radius's row and column are 0 if it was held fixed. `residual` (N,):
    signed distance of each point from the surface, positive outside. `jacobian` (N, 4): how the surface moves outwards
    at each point with centre and radius.
    """

    centre: Floats
    radius: float
    covariance: Floats
    residual: Floats
    jacobian: Floats

    @property
    def influence(self) -> Floats:
        """How centre and radius, both free, follow the points' distances, (4, N)."""
        return influence_on(self.jacobian, self.residual)

    @property
    def centre_sigma(self) -> Floats:
        """Standard deviation of each coordinate of the centre, (3,)."""
        sigma: Floats = np.sqrt(np.diag(self.covariance)[:3])
        return sigma

    @property
    def radius_sigma(self) -> float:
        """Standard deviation of the radius, 0 if it was held fixed."""
        return float(np.sqrt(self.covariance[3, 3]))


def fit_sphere(points: Floats, cluster: Ints, centre: Floats, radius: float, *, fixed_radius: bool = False) -> Sphere:
    """Minimise the points' (N, 3) distances from the surface by Gauss and Newton's method with Tukey's weights.

    Starts at `centre` (3,) and `radius`. `cluster` (N,): labels from 0 of points whose errors may be alike. Raises
    ValueError for fewer than four points.
    """
    if len(points) < 4:
        raise ValueError(f"a sphere needs four points, found {len(points)}")
    state = np.array([*centre, radius])
    free = 3 if fixed_radius else 4
    residual, jacobian = _distances(points, state)
    weight = biweight(residual)
    for _ in range(_STEPS):
        root = np.sqrt(weight)[:, None]
        step = np.linalg.lstsq(root * jacobian[:, :free], -root[:, 0] * residual, rcond=None)[0]
        state[:free] += step
        residual, jacobian = _distances(points, state)
        weight = biweight(residual)
        if np.linalg.norm(step) < _CONVERGED * radius:
            break
    covariance = np.zeros((4, 4))
    covariance[:free, :free] = robust_covariance(jacobian[:, :free], residual, cluster)
    return Sphere(state[:3].copy(), float(state[3]), covariance, residual, -jacobian)


def _distances(points: Floats, state: Floats) -> tuple[Floats, Floats]:
    """Signed distances (N,) of points from a sphere (centre, radius), and their derivatives (N, 4) by these."""
    from_centre = points - state[:3]
    length = np.linalg.norm(from_centre, axis=1)
    jacobian = np.hstack([-from_centre / length[:, None], -np.ones((len(points), 1))])
    return length - state[3], jacobian
