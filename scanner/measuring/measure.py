"""A finished scan → measurements."""

from pathlib import Path

import numpy as np

from calib.geometry import Calibration
from scanner.errors import InputError
from scanner.io import read_matches
from scanner.measuring.measurements import DistanceMeasurement, MeasuredScene, Measurements, distance_between
from scanner.measuring.planes import measure_scene
from scanner.measuring.spheres import centre_distances, measure_spheres
from scanner.results import CALIBRATION_FILE, FinishedScan, read_uncertainty

PixelPair = tuple[float, float, float, float]


def read_scene(folder: Path, calibration: Calibration) -> MeasuredScene:
    """Return the scene that a result with that calibration has measured, as its report states it. Raises InputError."""
    uncertainty = read_uncertainty(folder / CALIBRATION_FILE, calibration)
    return measure_scene(read_matches(folder), calibration, uncertainty)


def measure(
    scan: FinishedScan, scene: MeasuredScene, sphere_diameters: list[float], pixel_pairs: list[PixelPair]
) -> Measurements:
    """A sphere for each diameter (in the scan's unit), a distance for each pair of camera pixels, and the `scene`.

    Raises InputError for pixels without a point, NoMeasurementError if a sphere is not found.
    """
    distances = tuple(_pixel_distance(scan, scene, pair) for pair in pixel_pairs)
    spheres = measure_spheres(scan, sphere_diameters, scene.errors)
    return Measurements(scan.unit, scene, spheres, centre_distances(spheres) + distances)


def _pixel_distance(scan: FinishedScan, scene: MeasuredScene, pair: PixelPair) -> DistanceMeasurement:
    ends = (_point_at(scan, pair[:2]), _point_at(scan, pair[2:]))
    if ends[0] == ends[1]:
        raise InputError("--distance: both pixels are the same")
    return distance_between(scan, scene, ends)


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
