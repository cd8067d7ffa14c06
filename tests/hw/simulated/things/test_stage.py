"""Shadows on the stage, against those of a cube by similar triangles."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.geometry import IDENTITY
from hw.settings import ThingSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.things import Solid, TurntableScene

HALF_M = 0.05
_SIGNS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float64)
_SIDES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
_TRIANGLES = np.array([corners for a, b, c, d in _SIDES for corners in ([a, b, c], [a, c, d])])


@pytest.mark.parametrize("height_m", [0.2, 0.5, 3.0])
def test_a_cube_shades_what_a_light_straight_above_does_not_reach(height_m: float) -> None:
    """The floor is as far below the cube's middle as its top is above."""
    cube = Solid(HALF_M * _SIGNS, _TRIANGLES, np.full(8, 0.5))
    scene = TurntableScene(cube, IDENTITY, ThingSettings(kind="box", background=False))
    light = cast(PlacedDevice, SimpleNamespace(centre=np.array([0.0, 0.0, height_m])))
    floor_m = -2 * HALF_M
    edge_m = HALF_M * (height_m - floor_m) / (height_m - HALF_M)
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (2000, 3))
    points[:, 2] = floor_m
    across_m = np.abs(points[:, :2]).max(axis=1)
    sure = np.abs(across_m - edge_m) > 1e-4
    lit = scene.lit(points, light)
    assert 10 < np.count_nonzero(~lit) < 1500
    np.testing.assert_array_equal(lit[sure], across_m[sure] > edge_m)


def test_a_surface_does_not_shade_itself() -> None:
    cube = Solid(HALF_M * _SIGNS, _TRIANGLES, np.full(8, 0.5))
    scene = TurntableScene(cube, IDENTITY, ThingSettings(kind="box", background=False))
    light = cast(PlacedDevice, SimpleNamespace(centre=np.array([0.1, 0.2, 1.0])))
    points = np.random.default_rng(1).uniform(-0.99 * HALF_M, 0.99 * HALF_M, (500, 3))
    points[:, 2] = HALF_M
    assert scene.lit(points, light).all()
    points[:, 2] = -HALF_M
    assert not scene.lit(points, light).any()
