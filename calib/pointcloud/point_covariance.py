"""Propagates the decoder's noise to triangulated points."""

from dataclasses import replace

import numpy as np

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats


def point_covariances(matches: Matches, calibration: Calibration) -> Floats:
    """Covariance (N, 3, 3) of each triangulated point from `sigma_px` of its match, in the calibration's unit squared.

    Errors of the calibration, which neighbouring points share, are not included. Raises ValueError if the matches have
    no sigma.
    """
    if matches.sigma_px is None:
        raise ValueError("these matches have no sigma_px")
    by_sigma = matches.sigma_px[:, None, None] * by_projector_px(matches, calibration, matches.sigma_px)
    covariance: Floats = np.einsum("nia,nja->nij", by_sigma, by_sigma)
    return covariance


def by_projector_px(matches: Matches, calibration: Calibration, step_px: Floats) -> Floats:
    """Derivatives (N, 3, 2) of triangulated points by projector pixels: central differences over `step_px` (N,)."""
    derivative = np.empty((len(matches), 3, 2))
    for axis in (0, 1):
        step = step_px[:, None] * np.eye(2)[axis]
        ahead = intersect(replace(matches, projector_px=matches.projector_px + step), calibration).points
        behind = intersect(replace(matches, projector_px=matches.projector_px - step), calibration).points
        derivative[:, :, axis] = (ahead - behind) / (2 * step_px[:, None])
    return derivative
