"""Find the second projector coordinate from the first: intersect the camera pixel's epipolar line with the stripe.

In ideal coordinates the epipolar line is straight. The projector's lens bends it, while the stripe is straight in
projector pixels, so the intersection is found along the line by Newton's method.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry.calibration import Calibration
from calib.geometry.radial_distortion import distort_steps
from calib.numerics import Bools, Floats

_STEPS = 20
_CONVERGED_PX = 1e-9
_SAME_POINT = 1e-6  # in normalised coordinates


@dataclass(frozen=True)
class Crossings:
    """Intersections of camera pixels' epipolar lines with the observed stripes."""

    projector_px: Floats
    """The intersections, (N, 2)."""
    sine: Floats
    """Of the angle between line and stripe, in projector pixels, (N,): an error e of the known coordinate moves the
    intersection by e / sine along the line.
    """
    in_front: Bools
    """Whether the intersection exists and is the image of a point in front of both devices, (N,); otherwise
    `projector_px` is invalid and the angle ignores the lens.
    """


def cross_epipolar_lines(camera_px: Floats, known_px: Floats, axis: int, calibration: Calibration) -> Crossings:
    """The projector pixels on the epipolar lines of `camera_px` (N, 2) whose coordinate `axis` is `known_px` (N,).

    The line of a ray u is t × u (Hartley & Zisserman, 2nd ed., section 9.2), u in the projector's frame.
    """
    projector, rays = calibration.projector, calibration.pose.rotate(calibration.camera.unproject(camera_px)).T
    x, y, w = np.cross(calibration.pose.translation, rays, axisb=0).T
    across = 1 - axis
    focal, centre = np.array([projector.focal_px]).T, np.array([projector.principal_point_px]).T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        along = np.stack([-y, x]) / np.hypot(x, y)
        straight = np.abs(focal[axis] * along[axis]) / np.hypot(*(focal * along))
        ideal = np.empty((2, len(camera_px)))
        ideal[axis] = (known_px - centre[axis]) / focal[axis]
        ideal[across] = -((x, y)[axis] * ideal[axis] + w) / (x, y)[across]
        for _ in range(_STEPS):
            distorted, moved = distort_steps(ideal, along, projector.distortion)
            pixel, tangent = focal * distorted + centre, focal * moved
            step = (known_px - pixel[axis]) / tangent[axis]
            step_px = np.abs(step) * np.hypot(*tangent)
            if not np.nanmax(step_px, initial=0.0) > _CONVERGED_PX:
                break
            ideal = ideal + step * along
        sine = np.abs(tangent[axis]) / np.hypot(*tangent)
        # Beyond the lens's monotonic range another point projects to the same pixel.
        same = np.abs(projector.undistort(distorted.T).T - ideal).max(axis=0) < _SAME_POINT
        there = (step_px <= _CONVERGED_PX) & same & _in_front(ideal, rays, along, calibration.pose.translation)
    projector_px = pixel.T.copy()
    projector_px[:, axis] = known_px
    return Crossings(projector_px, np.where(there, sine, straight), there)


def _in_front(ideal: Floats, rays: Floats, along: Floats, translation: Floats) -> Bools:
    """Whether the point of each ray (3, N), in the projector's frame, with image `ideal` (2, N) is in front of both.

    With ρ the inverse of its depth in the camera, the point is proportional to ray + ρ translation.
    """
    offset = rays[:2] - ideal * rays[2]
    moved = ideal * translation[2] - translation[:2, None]
    inverse_depth = np.sum(offset * along, axis=0) / np.sum(moved * along, axis=0)
    in_front: Bools = (inverse_depth > 0) & (rays[2] + inverse_depth * translation[2] > 0)
    return in_front
