"""Shadows on the stage, against those of a cube by similar triangles."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.geometry import IDENTITY
from hw.settings import ThingSettings
from hw.simulated import PlacedDevice
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


@pytest.mark.parametrize("size_m", [0.1, 0.5])
def test_the_wall_behind_a_thing_leans_back_and_the_table_is_level(size_m: float) -> None:
    """The wall is 1.3 sizes behind the axis, and a tenth of that further back six sizes above the table."""
    cube = Solid(1e-6 * _SIGNS, _TRIANGLES, np.full(8, 0.5))
    scene = TurntableScene(cube, IDENTITY, ThingSettings(kind="box", size_m=size_m))
    eye = np.array([0.0, -2.0, 2.0]) * size_m
    places = np.random.default_rng(2).uniform((-5.0, 0.1), (5.0, 5.9), (300, 2)) * size_m
    wall = np.stack([places[:, 0], 1.3 * size_m * (1 + 0.1 * places[:, 1] / (6 * size_m)), places[:, 1]], axis=1)
    hits = scene.cast(eye, wall - eye)
    assert hits.there.all()
    assert not hits.thing.any()
    np.testing.assert_allclose(hits.points, wall, rtol=0, atol=1e-4 * size_m)
    table = np.random.default_rng(3).uniform((-5.0, 0.9, 0.0), (5.0, 1.25, 0.0), (300, 3)) * size_m
    hits = scene.cast(eye, table - eye)
    np.testing.assert_allclose(hits.points, table, rtol=0, atol=1e-4 * size_m)
    np.testing.assert_allclose(hits.normals, np.tile([0.0, 0.0, 1.0], (300, 1)), atol=1e-5)
    assert 0.35 <= hits.albedo.min() < 0.4
    assert 0.6 < hits.albedo.max() <= 0.65
