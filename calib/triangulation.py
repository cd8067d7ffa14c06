"""Matches and a calibration → points."""

from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats
from calib.calibration import Calibration


@dataclass(frozen=True)
class Triangulation:
    """`points` (N, 3) in the camera's frame and the calibration's unit; `gap_px` (N,): how far the projector pixel is
    from where the point projects to, in projector pixels; `in_front` (N,): in front of both devices.
    """

    points: Floats
    gap_px: Floats
    in_front: Bools


def triangulate(camera_px: Floats, projector_px: Floats, calibration: Calibration) -> Triangulation:
    """Intersect the two rays of each match: (N, 2) and (N, 2) pixels.

    The point is put on the camera's ray where it comes closest to the projector's ray (Hartley & Zisserman, 2nd ed.,
    section 12.2, with all error given to the projector, where the decoder's noise is). Pixels whose lens model has no
    inverse give NaN and are not in front.
    """
    camera_rays = calibration.camera.unproject(camera_px)
    directions = camera_rays @ calibration.rotation.T
    rays = calibration.projector.unproject(projector_px)
    t = calibration.translation

    # depth · direction + t is parallel to the projector's ray: two equations that are linear in the depth.
    a = directions[:, :2] - rays[:, :2] * directions[:, 2:]
    b = rays[:, :2] * t[2] - t[:2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.sum(a * b, axis=1) / np.sum(a * a, axis=1)
    points = camera_rays * depth[:, None]
    in_projector = points @ calibration.rotation.T + t
    gap = np.linalg.norm(calibration.projector.project(in_projector) - projector_px, axis=1)
    with np.errstate(invalid="ignore"):
        in_front: Bools = (depth > 0) & (in_projector[:, 2] > 0) & np.isfinite(gap)
    return Triangulation(points, gap, in_front)
