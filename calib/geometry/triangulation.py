"""Matches and a calibration → points."""

from dataclasses import dataclass

import numpy as np

from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.geometry.matches import Matches
from calib.numerics import Bools, Floats, by_columns, compiled, in_pieces

# Square of the sine of an angle that is nothing but rounding.
_PARALLEL = (8 * 2.0**-52) ** 2
_NUMBERS = 8  # that there are to a match, for pieces that fit into the cache


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

    in_pieces(count, fill, width=_NUMBERS)
    return met


def intersect_rays(camera_px: Floats, projector_px: Floats, calibration: Calibration) -> Intersections:
    """Triangulate matching pixels (N, 2) of any precision, all at once: meant for a piece that fits into the cache.

    The midpoint of the rays' common perpendicular (Beardsley et al. 1997; Hartley & Sturm 1997, section 5.1).
    """
    camera, projector, count = calibration.camera, calibration.projector, len(camera_px)
    # Coordinate by coordinate, (2, N) and (3, N), which is what can be vectorised.
    camera_px, projector_px = by_columns(camera_px).T, by_columns(projector_px).T
    points, foot_px = np.empty((3, count)), np.empty((2, count))
    depth, residual_px = np.empty(count), np.empty(count)
    camera_ideal, pose = _ideal(camera, camera_px), _pose(calibration)
    _meet(camera_ideal, _ideal(projector, projector_px), pose, points, depth)
    _miss(camera_ideal, depth, projector_px, _lens(projector), pose, foot_px, residual_px)
    return Intersections(points.T, foot_px.T, residual_px, np.isfinite(residual_px))


def _lens(device: Intrinsics) -> tuple[float, ...]:
    """Focal lengths, principal point and distortion."""
    return tuple(map(float, (*device.focal_px, *device.principal_point_px, *device.distortion)))


def _pose(calibration: Calibration) -> tuple[float, ...]:
    """Rows of the rotation, and the translation."""
    return (*calibration.rotation.ravel().tolist(), *calibration.translation.tolist())


def _ideal(device: Intrinsics, pixels: Floats) -> Floats:
    """Where the rays of pixels (2, N) meet z = 1, (2, N)."""
    inverse = device.inverse_for(pixels.shape[1])
    if inverse is not None:
        ideal = np.empty_like(pixels)
        if _undistort(pixels, _lens(device), *inverse, ideal):
            return ideal
    return by_columns(device.unproject(pixels.T)[:, :2]).T


@compiled
def _undistort(pixels: Floats, lens: tuple[float, ...], polynomial: Floats, largest: float, ideal: Floats) -> bool:
    """Fill in where rays meet z = 1, with a polynomial of `Intrinsics.inverse_for`; does it hold for all of them?"""
    per_fx, per_fy, x0, y0 = 1.0 / lens[0], 1.0 / lens[1], lens[2], lens[3]
    column, row = pixels[0], pixels[1]
    ratio, r2 = ideal[0], ideal[1]  # until the last loop overwrites them with the result
    beyond = 0
    for i in range(len(ratio)):
        x, y = (column[i] - x0) * per_fx, (row[i] - y0) * per_fy
        r2[i] = x * x + y * y
        beyond += r2[i] > largest
        ratio[i] = polynomial[-1]
    # Coefficient by coefficient: only a loop with none inside is vectorised.
    for k in range(len(polynomial) - 2, -1, -1):
        for i in range(len(ratio)):
            ratio[i] = ratio[i] * r2[i] + polynomial[k]
    for i in range(len(ratio)):
        ideal[1, i] = ratio[i] * (row[i] - y0) * per_fy
        ideal[0, i] = ratio[i] * (column[i] - x0) * per_fx
    return beyond == 0


@compiled
def _meet(
    camera_ideal: Floats, projector_ideal: Floats, pose: tuple[float, ...], points: Floats, depth: Floats
) -> None:
    """Fill in the midpoints, and z (N,) of the camera's ray where it is nearest to the projector's.

    `depth` is NaN where the rays do not meet in front of both devices.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22, tx, ty, tz = pose
    # Rows are taken out of the arrays before the loop: columns indexed inside it kept the compiler from vectorising.
    camera_x, camera_y = camera_ideal[0], camera_ideal[1]
    projector_x, projector_y = projector_ideal[0], projector_ideal[1]
    point_x, point_y, point_z = points[0], points[1], points[2]
    for i in range(len(depth)):
        # The rays' directions in the projector's frame: u the camera's; v, its own, is (vx, vy, 1).
        x, y, vx, vy = camera_x[i], camera_y[i], projector_x[i], projector_y[i]
        ux, uy, uz = r00 * x + r01 * y + r02, r10 * x + r11 * y + r12, r20 * x + r21 * y + r22
        # a u + t = b v as well as can be: both sides crossed with v, and with u, along u × v.
        cx, cy, cz = uy - uz * vy, uz * vx - ux, ux * vy - uy * vx
        cc, uu, vv = cx * cx + cy * cy + cz * cz, ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + 1.0
        along_u = ((vy * tz - ty) * cx + (tx - vx * tz) * cy + (ty * vx - tx * vy) * cz) / cc
        along_v = ((uy * tz - uz * ty) * cx + (uz * tx - ux * tz) * cy + (ux * ty - uy * tx) * cz) / cc
        # From the nearest point of the camera's ray half the way to that of the projector's.
        hx = 0.5 * (along_v * vx - along_u * ux - tx)
        hy = 0.5 * (along_v * vy - along_u * uy - ty)
        hz = 0.5 * (along_v - along_u * uz - tz)
        point_x[i] = along_u * x + r00 * hx + r10 * hy + r20 * hz
        point_y[i] = along_u * y + r01 * hx + r11 * hy + r21 * hz
        point_z[i] = along_u + r02 * hx + r12 * hy + r22 * hz
        meet = (along_u > 0.0) & (along_v > 0.0) & (cc > _PARALLEL * uu * vv)
        depth[i] = along_u if meet else np.nan


@compiled
def _miss(
    camera_ideal: Floats,
    depth: Floats,
    projector_px: Floats,
    lens: tuple[float, ...],
    pose: tuple[float, ...],
    foot_px: Floats,
    residual_px: Floats,
) -> None:
    """Fill in `foot_px` and `residual_px` of points of a `depth` (N,) on the camera's rays; NaN behind a device."""
    fx, fy, x0, y0, k1, k2, p1, p2, k3 = lens
    r00, r01, r02, r10, r11, r12, r20, r21, r22, tx, ty, tz = pose
    camera_x, camera_y, seen_x, seen_y = camera_ideal[0], camera_ideal[1], projector_px[0], projector_px[1]
    foot_x, foot_y = foot_px[0], foot_px[1]
    for i in range(len(depth)):
        x, y = camera_x[i], camera_y[i]
        ux, uy, uz = r00 * x + r01 * y + r02, r10 * x + r11 * y + r12, r20 * x + r21 * y + r22
        z = depth[i] * uz + tz
        x, y = (depth[i] * ux + tx) / z, (depth[i] * uy + ty) / z
        # Through the lens, as in `Intrinsics.distort`.
        r2 = x * x + y * y
        radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        column = fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + x0
        row = fy * (y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)) + y0
        # The tangent of the epipolar line, which the lens bends: where a step along the camera's ray moves the foot.
        step_x, step_y = ux - x * uz, uy - y * uz
        cross = slope * x * y + 2.0 * (p1 * x + p2 * y)
        along_x = fx * ((radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x) * step_x + cross * step_y)
        along_y = fy * (cross * step_x + (radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x) * step_y)
        length = np.sqrt(along_x * along_x + along_y * along_y)
        residual = (along_x * (seen_y[i] - row) - along_y * (seen_x[i] - column)) / length
        foot_x[i], foot_y[i] = column, row
        residual_px[i] = residual if z > 0.0 else np.nan


def nearest_depths(turned: Floats, directions: Floats, translation: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """The d that minimises |d p + t − s q| over d and s, for p, q (N, 3) and t (3,), and its derivatives by p, q, t.

    d = (b e − c g) / (a c − b²) with a = p·p, b = p·q, c = q·q, e = q·t, g = p·t.
    """
    p, q, t = turned, directions, translation
    a, b, c = (np.sum(x * y, axis=1)[:, None] for x, y in ((p, p), (p, q), (q, q)))
    e, g = (q @ t)[:, None], (p @ t)[:, None]
    determinant = a * c - b * b
    d = (b * e - c * g) / determinant
    by_p = (e * q - c * t - 2 * d * (c * p - b * q)) / determinant
    by_q = (e * p + b * t - 2 * g * q - 2 * d * (a * q - b * p)) / determinant
    return d[:, 0], by_p, by_q, (b * q - c * p) / determinant
