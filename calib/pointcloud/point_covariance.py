"""How the decoder's noise becomes a point's."""

from dataclasses import replace

import numpy as np

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Floats


def point_covariances(matches: Matches, calibration: Calibration) -> Floats:
    """Covariance (N, 3, 3) of each triangulated point from `sigma_px` of its match, in the calibration's unit squared.

    To first order, by central differences over one sigma. Errors of the calibration are not in it: they move
    neighbouring points alike. Raises ValueError if the matches have no sigma.
    """
    if matches.sigma_px is None:
        raise ValueError("these matches have no sigma_px")
    covariance = np.zeros((len(matches), 3, 3))
    for axis in (0, 1):
        step = matches.sigma_px[:, None] * np.eye(2)[axis]
        ahead = intersect(replace(matches, projector_px=matches.projector_px + step), calibration).points
        behind = intersect(replace(matches, projector_px=matches.projector_px - step), calibration).points
        by_sigma = (ahead - behind) / 2
        covariance += by_sigma[:, :, None] * by_sigma[:, None, :]
    return covariance
