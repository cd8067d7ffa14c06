"""Numerical derivatives, and the ground truth of a synthetic capture as a state and as cells of the refinement."""

from collections.abc import Callable, Iterable

import numpy as np

from calib.estimation import Cells
from calib.geometry import Intrinsics
from calib.numerics import Floats
from calib.refinement import PlacedCorner, State
from calib.rooms import Room
from calib.synthetic import SyntheticCapture


def gradient_of(
    function: Callable[[Room], Floats], room: Room, columns: Iterable[int] | None = None, step: float = 1e-6
) -> Floats:
    """Gradient of a function of rooms by some or all of the room's columns, (…, columns)."""
    slopes = []
    for column in range(room.size) if columns is None else columns:
        way = np.zeros(room.size)
        way[column] = step
        slopes.append((np.asarray(function(room.moved(way))) - function(room.moved(-way))) / (2 * step))
    return np.stack(slopes, axis=-1)


def device_of(intrinsics: Intrinsics) -> Floats:
    """Parameters f, x_0, y_0, k1, k2, p1, p2, k3, (8,)."""
    return np.array([intrinsics.focal_px[0], *intrinsics.principal_point_px, *intrinsics.distortion])


def true_state(capture: SyntheticCapture) -> State:
    calibration = capture.calibration
    corner = PlacedCorner(capture.corner.legs, capture.corner.vertex / calibration.baseline)
    return State(
        device_of(calibration.camera),
        device_of(calibration.projector),
        calibration.pose.in_baselines,
        np.zeros((1, 3)),
        (corner,),
    )


def each_a_cell(capture: SyntheticCapture, sigma_px: float = 1.0) -> Cells:
    """Every match as a cell of its own; all must be on a face."""
    matches, one = capture.matches, np.ones(len(capture.matches))
    return Cells(matches.camera_px, matches.projector_px, matches.face, sigma_px * one, one, sigma_px, 0.0)
