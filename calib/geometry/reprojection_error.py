"""The reprojection error of a solution on its own matches, and the signs of its legs."""

import numpy as np

from calib.geometry.calibration import Calibration
from calib.geometry.corner import Corner, depths_on_planes, leg_signs
from calib.geometry.matches import Matches
from calib.numerics import MEDIAN_LENGTH, Floats, evenly

_SAMPLE = 10_000  # the median of so many lengths is known to 0.7 %


def before_the_matches(corner: Corner, calibration: Calibration, matches: Matches) -> tuple[Corner, float]:
    """Return the corner with its legs pointing along its faces, and the reprojection error of the matches on them.

    The error is in projector pixels; both are computed from a sample of the matches.
    """
    labelled = matches[evenly(matches.labels >= 0, _SAMPLE)]
    rays = calibration.camera.unproject(labelled.camera_px)
    points = depths_on_planes(rays, corner.normals[labelled.labels], corner.vertex)[:, None] * rays
    signs = leg_signs(corner.legs, corner.vertex, points)
    return Corner(corner.vertex, corner.legs * signs[:, None]), _reprojection_error(calibration, points, labelled)


def _reprojection_error(calibration: Calibration, points: Floats, labelled: Matches) -> float:
    """Root mean square distance in the projector between matches and their points (N, 3); robust.

    The median length is scaled to the root mean square of a 2-D normal deviate, so that outliers do not count.
    """
    predicted = calibration.projector.project(calibration.pose @ points)
    error = np.linalg.norm(predicted - labelled.projector_px, axis=1)
    return float(np.nanmedian(error) * np.sqrt(2) / MEDIAN_LENGTH)
