"""A finished scan → measurements."""

import numpy as np

from calib.numerics import Floats
from calib.pointcloud import point_covariances
from scanner.errors import InputError
from scanner.measuring.measurements import DistanceMeasurement, Measurements
from scanner.measuring.planes import measure_faces
from scanner.measuring.spheres import centre_distances, measure_spheres
from scanner.results import FinishedScan

PixelPair = tuple[float, float, float, float]


def measure(scan: FinishedScan, sphere_diameters: list[float], pixel_pairs: list[PixelPair]) -> Measurements:
    """The faces, a sphere for each diameter (in the scan's unit), a distance for each pair of camera pixels.

    Raises InputError for pixels without a point, NoMeasurementError if a sphere is not found.
    """
    distances = tuple(_pixel_distance(scan, pair) for pair in pixel_pairs)
    spheres = measure_spheres(scan, sphere_diameters)
    faces, angles = measure_faces(scan.points, scan.pixel, scan.matches.face, scan.calibration.camera.width)
    return Measurements(scan.unit, spheres, faces, angles, centre_distances(spheres) + distances)


def _pixel_distance(scan: FinishedScan, pair: PixelPair) -> DistanceMeasurement:
    ends = [_point_at(scan, pair[:2]), _point_at(scan, pair[2:])]
    points = scan.points[ends]
    apart = points[1] - points[0]
    distance = float(np.linalg.norm(apart))
    if distance == 0:
        raise InputError("--distance: both pixels are the same")
    return DistanceMeasurement(
        (_pixel_name(scan, ends[0]), _pixel_name(scan, ends[1])),
        points,
        distance,
        _sigma_along(scan, ends, apart / distance),
    )


def _pixel_name(scan: FinishedScan, point: int) -> str:
    column, row = scan.pixel[point]
    return f"pixel ({column}, {row})"


def _point_at(scan: FinishedScan, at: tuple[float, ...]) -> int:
    """The point of the camera pixel at `at` (x, y). Raises InputError if it has none."""
    camera = scan.calibration.camera
    x, y = at
    if not (-0.5 <= x <= camera.width - 0.5 and -0.5 <= y <= camera.height - 0.5):
        raise InputError(
            f"--distance: pixel ({x:g}, {y:g}) is outside of the camera's image, which is {camera.width} × "
            f"{camera.height} pixels"
        )
    apart = np.linalg.norm(scan.pixel - np.array(at), axis=1)
    nearest = int(np.argmin(apart))
    if np.abs(scan.pixel[nearest] - np.array(at)).max() > 0.5:
        column, row = scan.pixel[nearest]
        raise InputError(
            f"--distance: there is no point at camera pixel ({x:g}, {y:g}); the nearest that has one is "
            f"({column}, {row})"
        )
    return nearest


def _sigma_along(scan: FinishedScan, ends: list[int], direction: Floats) -> float | None:
    """Standard deviation of the distance between two points from the decoder's noise; None where that is not known."""
    if scan.matches.sigma_px is None:
        return None
    covariance = point_covariances(scan.matches[np.array(ends)], scan.calibration).sum(axis=0)
    return float(np.sqrt(direction @ covariance @ direction))
