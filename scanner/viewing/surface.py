"""The surface of a capture as triangles for the browser, coloured like its points, reduced for smooth rotation."""

import tempfile
from dataclasses import dataclass
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Ints
from calib.pointcloud import SeenPoints, image_triangles
from scanner.exporting import Mesh, write_glb
from scanner.viewing.result import CaptureCloud

_MOST_POINTS = 300_000


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles (T, 3) between points of a cloud, by number."""

    cloud: CaptureCloud
    triangles: Ints

    def glb(self, colours: NDArray[np.uint8], inside: Bools | None) -> tuple[bytes, int]:
        """Return the surface as binary glTF in the cloud's unit, y up, and its number of triangles.

        `colours` (N, 3) RGB; `inside` (N,): the points that it may connect.
        """
        kept = self.triangles if inside is None else self.triangles[np.all(inside[self.triangles], axis=1)]
        if not len(kept):
            return b"", 0
        used, corners = np.unique(kept, return_inverse=True)
        scan = self.cloud.scan
        triangles = corners.reshape(kept.shape).astype(np.int32)
        mesh = Mesh(scan.points[used], scan.normals[used], colours[used], triangles, scan.unit)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "mesh.glb")
            write_glb(path, mesh, 1.0)
            return path.read_bytes(), len(kept)


def surface_of(cloud: CaptureCloud) -> SurfaceMesh:
    """Triangles between neighbouring pixels, at every `step`th one of a large cloud."""
    scan = cloud.scan
    step = max(1, ceil(sqrt(len(scan) / _MOST_POINTS)))
    chosen = np.flatnonzero(np.all(scan.pixel % step == 0, axis=1))
    focal_px = float(np.mean(scan.calibration.camera.focal_px)) / step
    points = SeenPoints(scan.matches.camera_px[chosen] / step, scan.points[chosen], scan.normals[chosen], focal_px)
    triangles = image_triangles(points)
    return SurfaceMesh(cloud, chosen[triangles].astype(np.int32))
