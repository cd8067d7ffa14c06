"""Triangulation: matches and a calibration → points; the reprojection error of a solution on its own matches."""

from dataclasses import dataclass

import numpy as np

from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.geometry.corner import Corner, depths_on_planes, leg_signs
from calib.geometry.matches import Matches
from calib.geometry.radial_distortion import Distortion, Pinhole, distort_steps, distorted_point, undistort
from calib.numerics import MEDIAN_LENGTH, Bools, Floats, by_columns, compiled, evenly, in_pieces, inlined

# Squared sine of an angle below which it is rounding error.
_PARALLEL = (8 * 2.0**-52) ** 2
# Steps of Newton's method, from the plane that an ideal lens would show: distortion is small.
_LENS_STEPS = 3
# Largest last step towards an ideal point: the error after it, about its square, is below the rounding of a pixel.
_CONVERGED = 3e-5
_LEAST_DETERMINANT = 1e-15  # of two rays; with length 1, the squared sine of their angle
_NUMBERS = 8  # numbers per match, to choose pieces that fit into the cache


@dataclass(frozen=True)
class Intersections:
    """Intersections of the two rays of each match."""

    points: Floats
    """In the camera's frame and the calibration's unit, (N, 3)."""
    foot_px: Floats
    """Projector image of the closest point on the camera's ray, (N, 2)."""
    residual_px: Floats
    """Signed distance of the projector pixel from the camera pixel's epipolar line, (N,)."""
    in_front: Bools
    """In front of both devices, with every number finite, (N,)."""


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


def midpoints(matches: Matches, calibration: Calibration) -> Floats:
    """The points (3, N) of `intersect` alone, all at once: meant for a piece that fits into the cache."""
    points = np.empty((3, len(matches)))
    ideal = _ideal(calibration.camera, matches.camera_px), _ideal(calibration.projector, matches.projector_px)
    _meet(*ideal, _pose(calibration), points)
    return points


def intersect_rays(camera_px: Floats, projector_px: Floats, calibration: Calibration) -> Intersections:
    """Triangulate matching pixels (N, 2) of any precision, all at once: meant for a piece that fits into the cache.

    The midpoint of the rays' common perpendicular (Beardsley et al. 1997; Hartley & Sturm 1997, section 5.1).
    """
    projector, count = calibration.projector, len(camera_px)
    # Coordinate by coordinate, (2, N) and (3, N), which is what can be vectorised.
    observed = by_columns(projector_px).T
    ideal = _ideal(calibration.camera, camera_px), _ideal(projector, observed.T)
    points, foot_px, residual_px = np.empty((3, count)), np.empty((2, count)), np.empty(count)
    device = projector.pinhole, projector.distortion
    _intersect(*ideal, observed, _pose(calibration), *device, points, foot_px, residual_px)
    return Intersections(points.T, foot_px.T, residual_px, np.isfinite(residual_px))


def depths_on_stripes(
    camera_ideal: Floats, known_px: Floats, axis: int, calibration: Calibration
) -> tuple[Floats, Floats]:
    """Depths (N,) where camera rays meet the planes of light of projector pixels whose coordinate `axis` is `known_px`.

    Also returns their derivative by the coordinate, per pixel (N,). NaN where they do not meet in front of both
    devices. `camera_ideal` (2, N): where the rays meet z = 1. For an ideal lens z = (t_a − ξ t_z) / (ξ u_z − u_a), with
    u the ray in the projector's frame, a the axis, and ξ the plane at z = 1; Newton's method corrects for distortion.
    """
    projector, pose, count = calibration.projector, _pose(calibration), len(known_px)
    focal, centre = projector.focal_px[axis], projector.principal_point_px[axis]
    depth, ideal, step = np.empty(count), np.empty((2, count)), np.empty((2, count))
    _meet_planes(camera_ideal, (known_px - centre) / focal, pose, axis, depth)
    ahead = calibration.pose.rotation[2, :2] @ camera_ideal + calibration.pose.rotation[2, 2]
    for remaining in range(_LENS_STEPS if any(projector.distortion) else 0, -1, -1):
        _seen(camera_ideal, depth, pose, ideal, step)
        distorted, moved = distort_steps(ideal, step, projector.distortion)
        per_depth = focal * moved[axis] / (depth * ahead + calibration.pose.translation[2])
        if remaining:
            depth += (known_px - focal * distorted[axis] - centre) / per_depth
    per_px: Floats = 1 / per_depth
    return depth, per_px


def _ideal(device: Intrinsics, pixels: Floats) -> Floats:
    """Where the rays of pixels (N, 2) meet z = 1, (2, N)."""
    return by_columns(undistort(pixels, device.distortion, device.pinhole, converged=_CONVERGED)).T


def _pose(calibration: Calibration) -> tuple[float, ...]:
    """Rows of the rotation, and the translation."""
    return (*calibration.pose.rotation.ravel().tolist(), *calibration.pose.translation.tolist())


@inlined
def _nearest(x: float, y: float, vx: float, vy: float, pose: tuple[float, ...]) -> tuple[float, float, float, float]:
    """The midpoint of the common perpendicular of the camera's ray (x, y, 1) and the projector's, (vx, vy, 1), and z of
    the camera's ray where it is nearest to the projector's; NaN if they do not meet in front of both devices.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22, tx, ty, tz = pose
    # The rays' directions in the projector's frame: u the camera's; v, its own, is (vx, vy, 1).
    ux, uy, uz = r00 * x + r01 * y + r02, r10 * x + r11 * y + r12, r20 * x + r21 * y + r22
    # a u + t = b v as well as can be: both sides crossed with v, and with u, along u × v.
    cx, cy, cz = uy - uz * vy, uz * vx - ux, ux * vy - uy * vx
    cc, uu, vv = cx * cx + cy * cy + cz * cz, ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + 1.0
    per_cc = 1.0 / cc
    along_u = ((vy * tz - ty) * cx + (tx - vx * tz) * cy + (ty * vx - tx * vy) * cz) * per_cc
    along_v = ((uy * tz - uz * ty) * cx + (uz * tx - ux * tz) * cy + (ux * ty - uy * tx) * cz) * per_cc
    # Halfway between the nearest points of both rays.
    hx = 0.5 * (along_v * vx - along_u * ux - tx)
    hy = 0.5 * (along_v * vy - along_u * uy - ty)
    hz = 0.5 * (along_v - along_u * uz - tz)
    meet = (along_u > 0.0) & (along_v > 0.0) & (cc > _PARALLEL * uu * vv)
    return (
        along_u * x + r00 * hx + r10 * hy + r20 * hz,
        along_u * y + r01 * hx + r11 * hy + r21 * hz,
        along_u + r02 * hx + r12 * hy + r22 * hz,
        along_u if meet else np.nan,
    )


@inlined
def _projected(x: float, y: float, depth: float, pose: tuple[float, ...]) -> tuple[float, float, float, float]:
    """The projector image, at z = 1, of the point at `depth` on the camera's ray (x, y, 1), and its derivative along
    the ray; NaN for a point behind the projector.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22, tx, ty, tz = pose
    ux, uy, uz = r00 * x + r01 * y + r02, r10 * x + r11 * y + r12, r20 * x + r21 * y + r22
    z = depth * uz + tz
    inverse = 1.0 / z if z > 0.0 else np.nan
    x, y = (depth * ux + tx) * inverse, (depth * uy + ty) * inverse
    return x, y, ux - x * uz, uy - y * uz


@compiled
def _meet(camera_ideal: Floats, projector_ideal: Floats, pose: tuple[float, ...], points: Floats) -> None:
    """Fill in the midpoints (3, N) of rays."""
    # Rows are taken out of the arrays before the loop: columns indexed inside it kept the compiler from vectorising.
    camera_x, camera_y = camera_ideal[0], camera_ideal[1]
    projector_x, projector_y = projector_ideal[0], projector_ideal[1]
    x, y, z = points[0], points[1], points[2]
    for i in range(len(x)):
        x[i], y[i], z[i], _ = _nearest(camera_x[i], camera_y[i], projector_x[i], projector_y[i], pose)


@compiled
def _intersect(
    camera_ideal: Floats,
    projector_ideal: Floats,
    projector_px: Floats,
    pose: tuple[float, ...],
    pinhole: Pinhole,
    distortion: Distortion,
    points: Floats,
    foot_px: Floats,
    residual_px: Floats,
) -> None:
    """Fill in the midpoints (3, N), and the distances (N,) of the projector's pixels (2, N) from the epipolar lines,
    whose nearest points are `foot_px` (2, N). `pinhole`: the projector's focal lengths and principal point.
    """
    fx, fy, x0, y0 = pinhole
    camera_x, camera_y = camera_ideal[0], camera_ideal[1]
    projector_x, projector_y = projector_ideal[0], projector_ideal[1]
    x, y, z, foot_x, foot_y = points[0], points[1], points[2], foot_px[0], foot_px[1]
    seen_x, seen_y = projector_px[0], projector_px[1]
    for i in range(len(residual_px)):
        x[i], y[i], z[i], depth = _nearest(camera_x[i], camera_y[i], projector_x[i], projector_y[i], pose)
        ideal_x, ideal_y, step_x, step_y = _projected(camera_x[i], camera_y[i], depth, pose)
        u, v, a, b, d = distorted_point(ideal_x, ideal_y, distortion)
        column, row = fx * u + x0, fy * v + y0
        # The direction of the epipolar line at its foot, as the lens bends it.
        along_x, along_y = fx * (a * step_x + b * step_y), fy * (b * step_x + d * step_y)
        length = np.sqrt(along_x * along_x + along_y * along_y)
        foot_x[i], foot_y[i] = column, row
        residual_px[i] = (along_x * (seen_y[i] - row) - along_y * (seen_x[i] - column)) / length


@compiled
def _meet_planes(camera_ideal: Floats, plane: Floats, pose: tuple[float, ...], axis: int, depth: Floats) -> None:
    """Fill in where the camera's rays meet the planes x = `plane` z, or y for the other axis, of the projector."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22, tx, ty, tz = pose
    a0, a1, a2, ta = (r00, r01, r02, tx) if axis == 0 else (r10, r11, r12, ty)
    camera_x, camera_y = camera_ideal[0], camera_ideal[1]
    for i in range(len(depth)):
        x, y = camera_x[i], camera_y[i]
        along = (ta - plane[i] * tz) / (plane[i] * (r20 * x + r21 * y + r22) - (a0 * x + a1 * y + a2))
        depth[i] = along if along > 0.0 else np.nan


@compiled
def _seen(camera_ideal: Floats, depth: Floats, pose: tuple[float, ...], ideal: Floats, step: Floats) -> None:
    """Fill in the projector images (2, N), at z = 1, of points at `depth` (N,) on the camera's rays, and derivatives
    of these images along the rays.
    """
    camera_x, camera_y = camera_ideal[0], camera_ideal[1]
    x, y, step_x, step_y = ideal[0], ideal[1], step[0], step[1]
    for i in range(len(depth)):
        x[i], y[i], step_x[i], step_y[i] = _projected(camera_x[i], camera_y[i], depth[i], pose)


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


def depths_of_rays(turned: Floats, directions: Floats, translation: Floats) -> Floats:
    """The d and s (N, 2) that minimise |d p + t − s q|, for p, q (N, 3) and t (3,); huge for parallel rays."""
    p, q, t = turned, directions, translation
    a, b, c = (np.sum(x * y, axis=1) for x, y in ((p, p), (p, q), (q, q)))
    e, g = q @ t, p @ t
    determinant = np.maximum(a * c - b**2, _LEAST_DETERMINANT)
    depths: Floats = np.stack([b * e - c * g, a * e - b * g], axis=1) / determinant[:, None]
    return depths


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
