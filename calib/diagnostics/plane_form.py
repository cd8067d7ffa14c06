"""Flatness of a face: the smooth part of the distances of its points from a plane."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import CUBIC, Floats, Ints, biweight, influence_on, monomials, orthonormal, robust_covariance
from calib.pointcloud import Plane

_LINEAR = 3


@dataclass(frozen=True)
class PlaneForm:
    """Distances of points from a plane as a sum of modes that are orthonormal in the mean over the points.

    The modes are quadratic and cubic in the image, and orthogonal to any tilt or shift of the plane. `amplitudes` (K,),
    their `covariance` (K, K) by scatter alone, and their derivatives by the points' distances, `influence` (K, N).
    """

    amplitudes: Floats
    covariance: Floats
    influence: Floats

    @property
    def deviation(self) -> float:
        """Root mean square of the smooth part of the distances."""
        return float(np.linalg.norm(self.amplitudes))


def plane_form(plane: Plane, camera_px: Floats, cluster: Ints) -> PlaneForm:
    """The form of the points that a plane was fitted to, at pixels (N, 2); errors correlate in a `cluster` (N,)."""
    terms = monomials(camera_px)[:, _LINEAR:CUBIC]
    basis = orthonormal(np.concatenate([plane.jacobian.T, terms.T]).T)
    # Plane and form are fitted together: under the points' weights they are not quite orthogonal.
    modes = np.sqrt(len(camera_px)) * basis
    weighted = biweight(plane.residual)[:, None] * modes
    amplitudes = np.linalg.lstsq(weighted.T @ modes, weighted.T @ plane.residual, rcond=None)[0]
    left = plane.residual - modes @ amplitudes
    form = slice(_LINEAR, None)
    covariance = robust_covariance(modes, left, cluster)[form, form]
    return PlaneForm(amplitudes[form], covariance, influence_on(modes, left)[form])
