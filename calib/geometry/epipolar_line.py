"""One projector coordinate and a calibration → the other: where the camera pixel's epipolar line crosses the stripe.

In ideal coordinates the epipolar line is straight. The projector's lens bends it, and the stripe is straight in the
projector's own pixels, so the crossing is found along the line by Newton's method.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.numerics import Bools, Floats

_STEPS = 20
_CONVERGED_PX = 1e-9


@dataclass(frozen=True)
class Crossings:
    """Where camera pixels' epipolar lines cross the stripes that were seen.

    `projector_px` (N, 2); `sine` (N,): of the angle between line and stripe, in projector pixels: an error e of the
    known coordinate moves the crossing by e / sine along the line. `in_front` (N,): whether the crossing exists, and is
    the image of a point in front of both devices; where not, `projector_px` means nothing, and the angle is that
    without the lens.
    """

    projector_px: Floats
    sine: Floats
    in_front: Bools


def cross_epipolar_lines(camera_px: Floats, known_px: Floats, axis: int, calibration: Calibration) -> Crossings:
    """The projector pixels on the epipolar lines of `camera_px` (N, 2) whose coordinate `axis` is `known_px` (N,).

    The line of a ray u is t × u (Hartley & Zisserman, 2nd ed., section 9.2), u in the projector's frame.
    """
    projector, rays = calibration.projector, calibration.camera.unproject(camera_px) @ calibration.rotation.T
    lines = np.cross(calibration.translation, rays)
    other = 1 - axis
    focal, centre = np.array(projector.focal_px), np.array(projector.principal_point_px)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        along = np.stack([-lines[:, 1], lines[:, 0]], axis=1) / np.hypot(*lines[:, :2].T)[:, None]
        ideal = np.empty((len(camera_px), 2))
        ideal[:, axis] = (known_px - centre[axis]) / focal[axis]
        ideal[:, other] = -(lines[:, axis] * ideal[:, axis] + lines[:, 2]) / lines[:, other]
        straight = np.abs(focal[axis] * along[:, axis]) / np.hypot(*(focal * along).T)
        for _ in range(_STEPS):
            pixel, tangent = projector.distort(ideal) * focal + centre, _tangents(projector, ideal, along)
            step = (known_px - pixel[:, axis]) / tangent[:, axis]
            step_px = np.abs(step) * np.hypot(*tangent.T)
            if not np.nanmax(step_px, initial=0.0) > _CONVERGED_PX:
                break
            ideal += step[:, None] * along
        sine = np.abs(tangent[:, axis]) / np.hypot(*tangent.T)
        there = (step_px <= _CONVERGED_PX) & projector.is_invertible(ideal)
        there &= _in_front(ideal, rays, along, calibration.translation)
    pixel[:, axis] = known_px
    return Crossings(pixel, np.where(there, sine, straight), there)


def _tangents(projector: Intrinsics, ideal: Floats, along: Floats) -> Floats:
    """How pixels move per step `along` (N, 2) the ideal epipolar line, (N, 2)."""
    (a, b), (c, d) = projector.distortion_jacobian(ideal)
    moved = np.stack([a * along[:, 0] + b * along[:, 1], c * along[:, 0] + d * along[:, 1]], axis=1)
    moved *= np.array(projector.focal_px)
    return moved


def _in_front(ideal: Floats, rays: Floats, along: Floats, translation: Floats) -> Bools:
    """Whether the point of each ray (N, 3), in the projector's frame, that is seen at `ideal` (N, 2) has z > 0 twice.

    With ρ one over its depth before the camera, the point is in proportion to ray + ρ translation.
    """
    offset = rays[:, :2] - ideal * rays[:, 2:]
    moved = ideal * translation[2] - translation[:2]
    inverse_depth = np.sum(offset * along, axis=1) / np.sum(moved * along, axis=1)
    in_front: Bools = (inverse_depth > 0) & (rays[:, 2] + inverse_depth * translation[2] > 0)
    return in_front
