"""Matches and a calibration → points."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools, Floats
from calib.calibration import Calibration
from calib.matches import Matches

# Pieces of this many matches stay in the processor's cache: twice as fast as all at once.
_PIECE = 1 << 16


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
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        parts = list(
            pool.map(
                lambda at: _intersect_piece(matches.camera_px[at], matches.projector_px[at], calibration),
                pieces(len(matches)),
            )
        )
    return Intersections(
        np.concatenate([piece.points for piece in parts]),
        np.concatenate([piece.foot_px for piece in parts]),
        np.concatenate([piece.residual_px for piece in parts]),
        np.concatenate([piece.in_front for piece in parts]),
    )


def _intersect_piece(camera_px: Floats, projector_px: Floats, calibration: Calibration) -> Intersections:
    """The midpoint of the rays' common perpendicular (Beardsley et al. 1997; Hartley & Sturm 1997, section 5.1)."""
    camera, projector = calibration.camera, calibration.projector
    u = camera.unproject(camera_px)
    v = projector.unproject(projector_px) @ calibration.rotation
    origin = calibration.projector_centre
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    u_origin, v_origin = u @ origin, v @ origin
    with np.errstate(divide="ignore", invalid="ignore"):
        along_u = (vv * u_origin - uv * v_origin) / (uu * vv - uv * uv)
        along_v = (uv * u_origin - uu * v_origin) / (uu * vv - uv * uv)
        on_camera_ray = along_u[:, None] * u
        points = 0.5 * (on_camera_ray + origin + along_v[:, None] * v)
        # A small step along the camera's ray moves the foot along the epipolar line, whatever the lens.
        in_projector = on_camera_ray @ calibration.rotation.T + calibration.translation
        foot = projector.project(in_projector)
        along = projector.project(in_projector + 1e-4 * on_camera_ray @ calibration.rotation.T) - foot
        miss = projector_px - foot
        residual = (along[:, 0] * miss[:, 1] - along[:, 1] * miss[:, 0]) / np.hypot(along[:, 0], along[:, 1])
        in_front = (along_u > 0) & (along_v > 0) & np.isfinite(residual)
    return Intersections(points, foot, residual, in_front)


def _dot(a: Floats, b: Floats) -> Floats:
    products: Floats = np.einsum("ij,ij->i", a, b)
    return products


def pieces(count: int) -> list[slice]:
    """Slices that cut `count` elements into parts small enough for a processor's cache."""
    return [slice(start, start + _PIECE) for start in range(0, max(1, count), _PIECE)]
