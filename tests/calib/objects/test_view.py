"""Reliability of a view's normals: not at the rim, where fitting windows are one-sided."""

import numpy as np

from calib.geometry import Intrinsics
from calib.objects import view_of
from calib.pointcloud import surface

SIDE, FOCAL = 160, 400.0
SHADOW = -45  # pixels from the middle: what is left of it the projector does not reach


def test_interior_normals_are_unbiased_and_rim_normals_tilt_towards_the_camera() -> None:
    middle, radius = np.array([0.0, 0.0, 3.0]), 0.5
    row, column = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    rays = np.stack([column / FOCAL, row / FOCAL, np.ones_like(row)], axis=-1)
    along, square = rays @ middle, np.sum(rays**2, axis=-1)
    inside = along**2 - square * (middle @ middle - radius**2)
    points = np.where((inside > 0) & (column > SHADOW), (along - np.sqrt(np.maximum(inside, 0))) / square, np.nan)[
        ..., None
    ]
    points = points * rays
    cloud = points.astype(np.float32)
    point = ((SIDE - 1) / 2, (SIDE - 1) / 2)
    view = view_of(cloud, surface(cloud, FOCAL).normals, Intrinsics(SIDE, SIDE, (FOCAL, FOCAL), point))
    assert view is not None
    seen = view.pixel
    true = (points - middle).reshape(-1, 3)[seen] / radius
    facing = -np.sum(true * view.patches.points, axis=1) / np.linalg.norm(view.patches.points, axis=1)
    bias, inner = view.facing(seen) - facing, view.inner[seen]
    flat = facing > 0.6  # beyond, a window's middle is no longer its surface's
    assert 0.6 < inner.mean() < 0.98
    assert abs(bias[inner & flat].mean()) < 0.001
    assert bias[~inner & flat].mean() > 0.008
