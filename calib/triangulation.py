"""Matches and a calibration → points."""

from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats
from calib.calibration import Calibration
from calib.matches import Matches
from calib.pieces import by_columns, in_pieces


@dataclass(frozen=True)
class Intersections:
    """Where the two rays of each match meet.

    `points` (N, 3) in the camera's frame and the calibration's unit; `foot_px` (N, 2): where the projector sees the
    point of the camera's ray that comes closest; `residual_px` (N,): signed distance of the projector pixel from the
    camera pixel's epipolar line; `in_front` (N,): in front of both devices, with every number finite.
    """

    points: Floats
    foot_px: Floats
    residual_px: Floats
    in_front: Bools


def intersect(matches: Matches, calibration: Calibration) -> Intersections:
    """Triangulate every match."""
    count = len(matches)
    met = Intersections(np.empty((count, 3)), np.empty((count, 2)), np.empty(count), np.empty(count, np.bool_))

    def fill(at: slice) -> None:
        part = intersect_rays(matches.camera_px[at], matches.projector_px[at], calibration)
        met.points[at], met.foot_px[at] = part.points, part.foot_px
        met.residual_px[at], met.in_front[at] = part.residual_px, part.in_front

    in_pieces(count, fill)
    return met


def intersect_rays(camera_px: Floats, projector_px: Floats, calibration: Calibration) -> Intersections:
    """Triangulate matching pixels (N, 2) of any precision, all at once: meant for a piece that fits into the cache.

    The midpoint of the rays' common perpendicular (Beardsley et al. 1997; Hartley & Sturm 1997, section 5.1).
    """
    camera, projector, rotation = calibration.camera, calibration.projector, calibration.rotation
    camera_px, projector_px = by_columns(camera_px), by_columns(projector_px)
    # Vectors are columns, (3, N): coordinate by coordinate numpy is fastest.
    u = camera.unproject(camera_px).T
    v = rotation.T @ projector.unproject(projector_px).T
    origin = calibration.projector_centre
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    u_origin, v_origin = origin @ u, origin @ v
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = uu * vv - uv * uv
        along_u = (vv * u_origin - uv * v_origin) / determinant
        along_v = (uv * u_origin - uu * v_origin) / determinant
        on_camera_ray = along_u * u
        points = along_v * v
        points += on_camera_ray
        points += origin[:, None]
        points *= 0.5
        # A small step along the camera's ray moves the foot along the epipolar line, whatever the lens.
        turned = rotation @ on_camera_ray
        in_projector = turned + calibration.translation[:, None]
        foot_px = projector.project(in_projector.T)
        turned *= 1e-4
        turned += in_projector
        along_x, along_y = (projector.project(turned.T) - foot_px).T
        miss_x, miss_y = (projector_px - foot_px).T
        residual_px = (along_x * miss_y - along_y * miss_x) / np.sqrt(along_x * along_x + along_y * along_y)
        in_front = (along_u > 0) & (along_v > 0) & np.isfinite(residual_px)
    return Intersections(points.T, foot_px, residual_px, in_front)


def _dot(a: Floats, b: Floats) -> Floats:
    products: Floats = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return products
