"""A solution held against the matches that it came from."""

import numpy as np

from calib.arrays import Floats
from calib.calibration import Calibration
from calib.camera import Intrinsics
from calib.cell_sums import evenly
from calib.cells import MEDIAN_LENGTH
from calib.corner import Corner
from calib.homography import FACES
from calib.matches import Matches

_SAMPLE = 50_000


def before_the_matches(corner: Corner, calibration: Calibration, matches: Matches) -> tuple[Corner, float]:
    """The corner with its legs pointing along its faces, and the reprojection error of the matches on them.

    The error is in projector pixels; a sample of the matches tells both.
    """
    assert matches.face is not None
    count = int(np.count_nonzero(matches.face >= 0))
    (chosen,) = evenly(matches.face, np.zeros(len(FACES), np.int32), [count], _SAMPLE)
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


def leg_signs(legs: Floats, vertex: Floats, points: Floats) -> Floats:
    """±1 (3,) for each leg (3, 3 rows): on which side of the vertex the points (N, 3) of its faces are."""
    # Coordinates along the legs; a point on face S has two, the third being zero.
    coordinates = np.linalg.solve(legs.T, (points - vertex).T)
    signs: Floats = np.sign(np.nanmedian(np.where(np.abs(coordinates) > 1e-9, coordinates, np.nan), axis=1))
    return signs


def _reprojection_error(calibration: Calibration, points: Floats, labelled: Matches) -> float:
    """Root mean square distance in the projector between matches and their points (N, 3); robust.

    The median length is scaled to the root mean square of a 2-D normal deviate, so that outliers do not count.
    """
    predicted = calibration.projector.project(points @ calibration.rotation.T + calibration.translation)
    error = np.linalg.norm(predicted - labelled.projector_px, axis=1)
    return float(np.nanmedian(error) * np.sqrt(2) / MEDIAN_LENGTH)
