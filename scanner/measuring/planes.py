"""Flatness of the corner's faces, and the angles between them."""

from itertools import combinations

import numpy as np

from calib.numerics import Floats, Ints, blocks
from calib.pointcloud import dihedral_angle_rad, fit_plane
from scanner.measuring.measurements import AngleMeasurement, FaceMeasurement, FitErrors
from scanner.quantities import FACE_NAMES

# Neighbouring points of a face err alike; squares of this share of the camera's image width count as independent.
_ALIKE_OF_WIDTH = 1 / 64
_FEWEST_POINTS = 100


def measure_faces(
    points: Floats, pixel: Ints, face: Ints | None, camera_width: int
) -> tuple[tuple[FaceMeasurement, ...], tuple[AngleMeasurement, ...]]:
    """From points (N, 3) at camera pixels (N, 2) with face labels (N,); nothing if they have none."""
    if face is None:
        return (), ()
    side_px = max(1, round(camera_width * _ALIKE_OF_WIDTH))
    faces, planes = [], {}
    for label, name in enumerate(FACE_NAMES):
        on = np.flatnonzero(face == label)
        if len(on) < _FEWEST_POINTS:
            continue
        plane = planes[name] = fit_plane(points[on], blocks(pixel[on], side_px))
        faces.append(FaceMeasurement(name, plane.normal, plane.offset, FitErrors(plane.residual, pixel[on])))
    angles = []
    for first, second in combinations(planes, 2):
        angle, sigma = np.degrees(dihedral_angle_rad(planes[first], planes[second]))
        angles.append(AngleMeasurement((first, second), float(angle), float(sigma)))
    return tuple(faces), tuple(angles)
