"""The surface as triangles between the pixels of the camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints
from calib.pointcloud import SeenPoints, image_triangles
from scanner.errors import InputError
from scanner.results import FinishedScan

# From the camera's axes (x right, y down, z forward) to glTF's (x right, y up, z backward).
Y_UP_FROM_CAMERA = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Mesh:
    """`points` and `normals` (N, 3) in the camera's frame and `unit`, `colours` (N, 3) RGB, `triangles` (T, 3).

    Triangles are counter-clockwise as seen by the camera.
    """

    points: Floats
    normals: Floats
    colours: NDArray[np.uint8]
    triangles: Ints
    unit: str


def build_mesh(scan: FinishedScan) -> Mesh:
    """Triangles between neighbouring pixels; points without a triangle are dropped. Raises InputError if there is no
    triangle.
    """
    focal_px = float(np.mean(scan.calibration.camera.focal_px))
    points = SeenPoints(scan.matches.camera_px, scan.points, scan.normals, focal_px)
    triangles = image_triangles(points)
    if len(triangles) == 0:
        raise InputError(
            "no three points are neighbours on a surface, so there is nothing to make a mesh of: export the cloud as "
            "ply instead"
        )
    used = np.zeros(len(scan.points), dtype=np.bool_)
    used[triangles.ravel()] = True
    corners = (np.cumsum(used, dtype=np.int32) - np.int32(1))[triangles]
    return Mesh(scan.points[used], scan.normals[used], scan.colours[used], corners, scan.unit)
