"""A finished result → measurements."""

from collections.abc import Sequence
from pathlib import Path

from calib.geometry import Calibration
from scanner.errors import InputError
from scanner.io import read_matches
from scanner.measuring.measurements import DistanceMeasurement, MeasuredScene, Measurements
from scanner.measuring.placed_points import PlacedPoints
from scanner.measuring.planes import measure_scene
from scanner.measuring.spheres import centre_distances, measure_spheres
from scanner.results import CALIBRATION_FILE, FinishedScan, read_uncertainty

# The number of a scan, from 0, and the x and y of a camera pixel.
PixelPlace = tuple[int, float, float]


def read_scene(folder: Path, calibration: Calibration, scan: Path | None = None) -> MeasuredScene:
    """Return the scene that a result with that calibration has measured, as its report states it: of the matches in the
    folder of a `scan`, by default the result's own. Raises InputError.
    """
    uncertainty = read_uncertainty(folder / CALIBRATION_FILE, calibration)
    return measure_scene(read_matches(folder if scan is None else scan), calibration, uncertainty)


def measure(
    scan: FinishedScan,
    scene: MeasuredScene,
    sphere_diameters: list[float],
    points: PlacedPoints | None = None,
    pixel_pairs: Sequence[tuple[PixelPlace, PixelPlace]] = (),
) -> Measurements:
    """A sphere for each diameter (in the scan's unit), the `scene`, and a distance for each pair of pixels of `points`.

    Raises InputError for pixels without a point, NoMeasurementError if a sphere is not found.
    """
    distances = () if points is None else tuple(_pixel_distance(points, pair) for pair in pixel_pairs)
    spheres = measure_spheres(scan, sphere_diameters, scene.errors)
    return Measurements(scan.unit, scene, spheres, centre_distances(spheres) + distances)


def measure_pixels(points: PlacedPoints, pixel_pairs: Sequence[tuple[PixelPlace, PixelPlace]]) -> Measurements:
    """A distance for each pair of pixels, alone: of a network, which has no faces. Raises InputError."""
    scene = MeasuredScene((), (), points.errors, None)
    return Measurements(points.unit, scene, (), tuple(_pixel_distance(points, pair) for pair in pixel_pairs))


def _pixel_distance(points: PlacedPoints, pair: tuple[PixelPlace, PixelPlace]) -> DistanceMeasurement:
    first, second = (points.at_pixel(station, (x, y)) for station, x, y in pair)
    if first == second:
        raise InputError("--distance: both pixels are the same")
    return points.distance((first, second))
