"""Robust geometric least-squares sphere through points, with its covariance."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Ints, biweight, influence_on, robust_covariance

_STEPS = 50
_CONVERGED = 1e-10
_STEEPEST = 0.17  # cosine of 80°; at steeper angles, noise decides whether a ray meets the sphere


@dataclass(frozen=True)
class Sphere:
    """`centre` (3,) and `radius`, in the unit of the points.

    `covariance` (4, 4) of centre and radius; the radius's row and column are 0 if it was held fixed. `residual` (N,):
    signed distance of each point from the surface, positive outside. `jacobian` (N, 4): derivatives of the surface's
    outward displacement at each point, by centre and radius.
    """

    centre: Floats
    radius: float
    covariance: Floats
    residual: Floats
    jacobian: Floats

    @property
    def influence(self) -> Floats:
        """Derivatives (4, N) of centre and radius, both free, by the points' distances."""
        return influence_on(self.jacobian, self.residual)

    @property
    def centre_sigma(self) -> Floats:
        """Standard deviation of each coordinate of the centre, (3,)."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def radius_sigma(self) -> float:
        """Standard deviation of the radius, 0 if it was held fixed."""
        return float(np.sqrt(self.covariance[3, 3]))


def fit_sphere(
    points: Floats,
    cluster: Ints,
    centre: Floats,
    radius: float,
    *,
    fixed_radius: bool = False,
    rays: Floats | None = None,
) -> Sphere:
    """Minimise the points' (N, 3) distances from the surface by Gauss and Newton's method with Tukey's weights.

    Starts at `centre` (3,) and `radius`. `cluster` (N,): labels from 0 of points whose errors may correlate. `rays`
    (N, 3): unit vectors from the cameras, along which the points err. Distances are then measured to the tangent planes
    where the rays meet the sphere; nearest points would bias the radius by the noise variance over the radius. Raises
    ValueError for fewer than four points.
    """
    if len(points) < 4:
        raise ValueError(f"a sphere needs four points, found {len(points)}")
    state = np.array([*centre, radius])
    free = 3 if fixed_radius else 4
    residual, jacobian = _distances(points, state, rays)
    weight = biweight(residual)
    for _ in range(_STEPS):
        root = np.sqrt(weight)[:, None]
        step = np.linalg.lstsq(root * jacobian[:, :free], -root[:, 0] * residual, rcond=None)[0]
        state[:free] += step
        residual, jacobian = _distances(points, state, rays)
        weight = biweight(residual)
        if np.linalg.norm(step) < _CONVERGED * radius:
            break
    covariance = np.zeros((4, 4))
    covariance[:free, :free] = robust_covariance(jacobian[:, :free], residual, cluster)
    return Sphere(state[:3].copy(), float(state[3]), covariance, residual, -jacobian)


def _distances(points: Floats, state: Floats, rays: Floats | None) -> tuple[Floats, Floats]:
    """Signed distances (N,) of points from a sphere (centre, radius), and their derivatives (N, 4) by these."""
    from_centre = points - state[:3]
    length = np.linalg.norm(from_centre, axis=1)
    outwards, distance = from_centre / length[:, None], length - state[3]
    if rays is not None:
        along = np.sum(from_centre * rays, axis=1)
        inside2 = along**2 - length**2 + state[3] ** 2  # half a ray's way through the sphere, squared
        meets = inside2 > (_STEEPEST * state[3]) ** 2
        before = -along[meets] - np.sqrt(inside2[meets])
        outwards[meets] = (from_centre[meets] + before[:, None] * rays[meets]) / state[3]
        distance[meets] = -before * np.sum(outwards[meets] * rays[meets], axis=1)
    return distance, np.hstack([-outwards, -np.ones((len(points), 1))])
