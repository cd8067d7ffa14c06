"""Matches and a calibration → points."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats
from calib.calibration import Calibration
from calib.matches import Matches

# Pieces of this many matches stay in the processor's cache: several times as fast as all at once.
_PIECE = 1 << 13


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

    def __getitem__(self, at: slice) -> "Intersections":
        """Views of a part."""
        return Intersections(self.points[at], self.foot_px[at], self.residual_px[at], self.in_front[at])


def intersect(matches: Matches, calibration: Calibration) -> Intersections:
    """Triangulate every match."""
    count = len(matches)
    met = Intersections(np.empty((count, 3)), np.empty((count, 2)), np.empty(count), np.empty(count, np.bool_))

    def fill(at: slice) -> None:
        part = matches[at]
        _intersect_piece(part.camera_px, part.projector_px, calibration, met[at])

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # Walking through the results raises what went wrong.
        for _ in pool.map(fill, pieces(count)):
            pass
    return met


def _intersect_piece(camera_px: Floats, projector_px: Floats, calibration: Calibration, met: Intersections) -> None:
    """The midpoint of the rays' common perpendicular (Beardsley et al. 1997; Hartley & Sturm 1997, section 5.1).

    Vectors are columns here, (3, N): coordinate by coordinate numpy is fastest.
    """
    camera, projector, rotation = calibration.camera, calibration.projector, calibration.rotation
    u = np.ascontiguousarray(camera.unproject(camera_px).T)
    v = rotation.T @ projector.unproject(projector_px).T
    origin = calibration.projector_centre
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    u_origin, v_origin = origin @ u, origin @ v
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = uu * vv - uv * uv
        along_u = (vv * u_origin - uv * v_origin) / determinant
        along_v = (uv * u_origin - uu * v_origin) / determinant
        on_camera_ray = along_u * u
        np.multiply(0.5, (on_camera_ray + origin[:, None] + along_v * v).T, out=met.points)
        # A small step along the camera's ray moves the foot along the epipolar line, whatever the lens.
        turned = rotation @ on_camera_ray
        in_projector = turned + calibration.translation[:, None]
        met.foot_px[:] = projector.project(in_projector.T)
        along_x, along_y = (projector.project((in_projector + 1e-4 * turned).T) - met.foot_px).T
        miss_x, miss_y = (projector_px - met.foot_px).T
        residual = (along_x * miss_y - along_y * miss_x) / np.sqrt(along_x * along_x + along_y * along_y)
        met.residual_px[:] = residual
        np.logical_and((along_u > 0) & (along_v > 0), np.isfinite(residual), out=met.in_front)


def _dot(a: Floats, b: Floats) -> Floats:
    products: Floats = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return products


def pieces(count: int) -> list[slice]:
    """Slices that cut `count` elements into parts small enough for a processor's cache."""
    return [slice(start, start + _PIECE) for start in range(0, max(1, count), _PIECE)]
