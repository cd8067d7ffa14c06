"""The corner in a result: its three faces as planes, where they meet, and how far each reaches."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Calibration, Corner, Matches, intersect
from calib.numerics import Floats
from scanner.measuring import AngleMeasurement, FaceMeasurement, measure_faces
from scanner.viewing.decimation import shuffled

# Planes through so many points are as good to look at as through all, and known at once.
FITTED_POINTS = 100_000

# A face ends where nearly all of its points do: strays would make it as large as the room behind them.
_REACH_QUANTILE = 0.995


@dataclass(frozen=True)
class MeasuredCorner:
    """`faces` A, B, C and the `angles` between them, measured; `corner` is where they meet, in the camera's frame.

    `outlines` (3, 4, 3): each face as a parallelogram that begins at the vertex, its points within.
    """

    corner: Corner
    faces: tuple[FaceMeasurement, ...]
    angles: tuple[AngleMeasurement, ...]
    outlines: Floats


def measured_corner(matches: Matches, calibration: Calibration) -> MeasuredCorner | None:
    """Fit the faces to points of at most `FITTED_POINTS` matches; None if the matches do not label all three."""
    part, points = triangulated(matches, calibration, FITTED_POINTS)
    label = part.face
    faces, angles = measure_faces(points, np.rint(part.camera_px).astype(np.int64), label, calibration.camera.width)
    if len(faces) < 3 or label is None:
        return None
    normals = np.stack([face.normal for face in faces])
    vertex = np.linalg.solve(normals, np.array([face.offset for face in faces]))
    legs = np.cross(np.roll(normals, -1, axis=0), np.roll(normals, -2, axis=0))
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    from_vertex = points - vertex
    for leg in range(3):
        beside = from_vertex[(label >= 0) & (label < 3) & (label != leg)]
        legs[leg] *= 1.0 if np.median(beside @ legs[leg]) >= 0 else -1.0
    outlines = [_outline(from_vertex[label == face], np.delete(legs, face, axis=0)) for face in range(3)]
    return MeasuredCorner(Corner(vertex, legs), faces, angles, vertex + np.stack(outlines))


def triangulated(matches: Matches, calibration: Calibration, count: int) -> tuple[Matches, Floats]:
    """At most `count` of the matches, spread evenly, with their points (n, 3); those behind a device are left out."""
    chosen = np.sort(shuffled(len(matches))[:count])
    part = matches[chosen]
    met = intersect(part, calibration)
    front = np.flatnonzero(met.in_front)
    return part[front], met.points[front]


def _outline(points: Floats, edges: Floats) -> Floats:
    """The parallelogram (4, 3) along two `edges` (2, 3) from the origin that nearly all `points` (N, 3) are within."""
    along = np.linalg.lstsq(edges.T, points.T, rcond=None)[0]
    first, second = np.maximum(np.quantile(along, _REACH_QUANTILE, axis=1), 0.0)[:, None] * edges
    return np.stack([np.zeros(3), first, first + second, second])
