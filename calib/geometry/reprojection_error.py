"""A solution held against the matches that it came from."""

import numpy as np

from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.geometry.corner import Corner, leg_signs
from calib.geometry.matches import Matches
from calib.numerics import MEDIAN_LENGTH, Floats, evenly

_SAMPLE = 50_000


def before_the_matches(corner: Corner, calibration: Calibration, matches: Matches) -> tuple[Corner, float]:
    """The corner with its legs pointing along its faces, and the reprojection error of the matches on them.

    The error is in projector pixels; a sample of the matches tells both.
    """
    assert matches.face is not None
    chosen = evenly(matches.face >= 0, _SAMPLE)
    labelled = matches[chosen]
    points = _on_faces(corner, calibration.camera, labelled)
    signs = leg_signs(corner.legs, corner.vertex, points)
    return Corner(corner.vertex, corner.legs * signs[:, None]), _reprojection_error(calibration, points, labelled)


def _on_faces(corner: Corner, camera: Intrinsics, labelled: Matches) -> Floats:
    """Where the camera's rays of labelled matches meet their faces, (N, 3) in the camera's frame."""
    normals = corner.normals[labelled.face]
    rays = camera.unproject(labelled.camera_px)
    points: Floats = (normals @ corner.vertex / np.sum(normals * rays, axis=1))[:, None] * rays
    return points


def _reprojection_error(calibration: Calibration, points: Floats, labelled: Matches) -> float:
    """Root mean square distance in the projector between matches and their points (N, 3); robust.

    The median length is scaled to the root mean square of a 2-D normal deviate, so that outliers do not count.
    """
    predicted = calibration.projector.project(points @ calibration.rotation.T + calibration.translation)
    error = np.linalg.norm(predicted - labelled.projector_px, axis=1)
    return float(np.nanmedian(error) * np.sqrt(2) / MEDIAN_LENGTH)
