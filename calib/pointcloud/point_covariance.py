"""How the decoder's noise becomes a point's."""

from dataclasses import replace

import numpy as np

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats


def point_covariances(matches: Matches, calibration: Calibration) -> Floats:
    """Covariance (N, 3, 3) of each triangulated point from `sigma_px` of its match, in the calibration's unit squared.

    Errors of the calibration are not in it: they move neighbouring points alike. Raises ValueError if the matches have
    no sigma.
    """
    if matches.sigma_px is None:
        raise ValueError("these matches have no sigma_px")
    by_sigma = matches.sigma_px[:, None, None] * by_projector_px(matches, calibration, matches.sigma_px)
    covariance: Floats = np.einsum("nia,nja->nij", by_sigma, by_sigma)
    return covariance


def by_projector_px(matches: Matches, calibration: Calibration, step_px: Floats) -> Floats:
    """How triangulated points move with the projector's pixels, (N, 3, 2): central differences over `step_px` (N,)."""
    derivative = np.empty((len(matches), 3, 2))
    for axis in (0, 1):
        step = step_px[:, None] * np.eye(2)[axis]
        ahead = intersect(replace(matches, projector_px=matches.projector_px + step), calibration).points
        behind = intersect(replace(matches, projector_px=matches.projector_px - step), calibration).points
        derivative[:, :, axis] = (ahead - behind) / (2 * step_px[:, None])
    return derivative
