"""Measured between points of the cloud: distances, and angles at one of them."""

from collections.abc import Sequence

import numpy as np

from calib.diagnostics import Budget, spread_of_points
from calib.numerics import Floats
from scanner.measuring.measurements import DistanceMeasurement, PointAngle, Scene
from scanner.results import FinishedScan

# Sine below which three points are collinear, where an angle has no derivative.
_LEAST_ACROSS = 1e-6


def distance_between(scan: FinishedScan, scene: Scene, ends: tuple[int, int]) -> DistanceMeasurement:
    """Between two different points of a scan, by number."""
    points = scan.points[[*ends]]
    apart = points[1] - points[0]
    distance = float(np.linalg.norm(apart))
    along = apart / distance
    names = (_pixel_name(scan, ends[0]), _pixel_name(scan, ends[1]))
    return DistanceMeasurement(names, points, distance, _budget(scan, scene, ends, np.concatenate([-along, along])))


def angle_at(scan: FinishedScan, scene: Scene, ends: tuple[int, int, int]) -> PointAngle:
    """Measure the angle at the second of three different points of a scan, given by index, between the lines to the
    others.
    """
    points = scan.points[[*ends]]
    to_first, to_last = points[0] - points[1], points[2] - points[1]
    first, last = to_first / np.linalg.norm(to_first), to_last / np.linalg.norm(to_last)
    cosine, sine = float(first @ last), float(np.linalg.norm(np.cross(first, last)))
    # An end that moves by d perpendicular to its line rotates the line by d over its length.
    by_first = (cosine * first - last) / (max(sine, _LEAST_ACROSS) * np.linalg.norm(to_first))
    by_last = (cosine * last - first) / (max(sine, _LEAST_ACROSS) * np.linalg.norm(to_last))
    gradient = np.degrees(np.concatenate([by_first, -by_first - by_last, by_last]))
    angle_deg = float(np.degrees(np.arctan2(sine, cosine)))
    return PointAngle(points, angle_deg, _budget(scan, scene, ends, gradient))


def _budget(scan: FinishedScan, scene: Scene, points: Sequence[int], gradient: Floats) -> Budget | None:
    """Return the error budget of a number that depends on points (n) by `gradient` (3 n,); None where their noise is
    unknown.
    """
    matches = scan.matches[np.array(points)]
    if matches.sigma_px is None:
        return None
    return spread_of_points(matches, scene.errors, matches.sigma_px).through(gradient[None]).budget()


def _pixel_name(scan: FinishedScan, point: int) -> str:
    column, row = scan.pixel[point]
    return f"pixel ({column}, {row})"
