"""The corner in a result: its three faces as planes, where they meet, and how far each reaches."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Corner, polar
from calib.numerics import Floats
from scanner.measuring import MeasuredScene
from scanner.results import FinishedScan
from scanner.viewing.decimation import shuffled

# This many points determine the extent of a face.
_OUTLINED_POINTS = 100_000

# The extent of a face ignores outliers, which would make it as large as the room behind them.
_REACH_QUANTILE = 0.995


@dataclass(frozen=True)
class MeasuredCorner:
    """`scene`: faces A, B, C and the angles between them, measured; `corner` is where they meet, in the camera's frame.

    `outlines` (3, 4, 3): each face as a parallelogram that begins at the vertex, its points within.
    """

    corner: Corner
    scene: MeasuredScene
    outlines: Floats


def measured_corner(scan: FinishedScan, scene: MeasuredScene) -> MeasuredCorner | None:
    """The corner of the faces that `scan measure` finds, too; None if the matches do not label all three."""
    chosen = np.sort(shuffled(len(scan))[:_OUTLINED_POINTS])
    points, faces = scan.points[chosen], scene.faces
    label = None if scan.matches.face is None else scan.matches.face[chosen]
    if len(faces) < 3 or label is None:
        return None
    normals = np.stack([face.normal for face in faces])
    vertex = np.linalg.solve(normals, np.array([face.offset for face in faces]))
    legs = polar(normals)
    from_vertex = points - vertex
    for leg in range(3):
        beside = from_vertex[(label >= 0) & (label < 3) & (label != leg)]
        legs[leg] *= 1.0 if np.median(beside @ legs[leg]) >= 0 else -1.0
    outlines = [_outline(from_vertex[label == face], np.delete(legs, face, axis=0)) for face in range(3)]
    return MeasuredCorner(Corner(vertex, legs), scene, vertex + np.stack(outlines))


def _outline(points: Floats, edges: Floats) -> Floats:
    """The parallelogram (4, 3) along two `edges` (2, 3) from the origin that nearly all `points` (N, 3) are within."""
    along = np.linalg.lstsq(edges.T, points.T, rcond=None)[0]
    first, second = np.maximum(np.quantile(along, _REACH_QUANTILE, axis=1), 0.0)[:, None] * edges
    return np.stack([np.zeros(3), first, first + second, second])
