"""What one station saw of a room."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics, Plane
from calib.rooms.marks import Marks, no_marks
from calib.rooms.segments import find_segments, relative_noise


@dataclass(frozen=True, eq=False)
class StationView:
    """An organised cloud in its camera's frame, with its planes.

    `points`, `normals` (H, W, 3), NaN for none; `labels` (H, W): index into `planes` of each pixel, −1 for none.
    `noise`: standard deviation of a point along its ray at depth z is `noise` · z². `marks`: of its picture on the
    planes, empty without a picture.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    labels: NDArray[np.int32]
    planes: tuple[Plane, ...]
    camera: Intrinsics
    noise: float
    marks: Marks = field(default_factory=no_marks)


def station_view(points: NDArray[np.float32], normals: NDArray[np.float32], camera: Intrinsics) -> StationView:
    """With planes found and noise measured; arguments as of `StationView`.

    Raises ValueError if the arrays do not have the size of the camera's image.
    """
    shape = (camera.height, camera.width, 3)
    if points.shape != shape or normals.shape != shape:
        raise ValueError(f"points and normals must have the shape {shape}, found {points.shape} and {normals.shape}")
    noise = relative_noise(points, normals)
    labels, planes = find_segments(points, normals, noise)
    return StationView(points, normals, labels, planes, camera, noise)
