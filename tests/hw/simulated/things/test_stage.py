"""Shadows on the stage, against those of a cube by similar triangles.

A simulated thing: its shape, its poses, and its ground truth.
"""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.geometry import IDENTITY, Matches, midpoints
from hw.errors import DeviceError
from hw.settings import SimulatedRigSettings, ThingSettings
from hw.simulated import PlacedDevice
from hw.simulated.things import SimulatedThing, Solid, TurntableScene
from hw.simulated.things.stage import draw_solid

HALF_M = 0.05
_SIGNS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float64)
_SIDES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
_TRIANGLES = np.array([corners for a, b, c, d in _SIDES for corners in ([a, b, c], [a, c, d])])
CAMERA, PROJECTOR = (153, 128), (427, 240)


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


@pytest.fixture(autouse=True)
def _with_open3d() -> None:
    """Not where every test process collects this file: loading it takes a second."""
    pytest.importorskip("open3d", exc_type=ImportError)


def thing(pose: int = 0, **settings: object) -> SimulatedThing:
    whole = {"seed": 3, "pose": pose, "thing": {"kind": "lump", "steps": 4, **settings}}
    return SimulatedThing(SimulatedRigSettings.model_validate(whole), CAMERA, PROJECTOR)


def test_a_ball_has_the_volume_and_area_of_a_sphere() -> None:
    ball = draw_solid(ThingSettings(kind="ball", size_m=0.2), np.random.default_rng(0))
    assert 0.998 < ball.volume / (4 / 3 * np.pi * 0.1**3) < 1
    assert 0.998 < ball.area / (4 * np.pi * 0.1**2) < 1


def test_the_turntable_rotates_about_the_vertical() -> None:
    first, second = (thing(pose).pose for pose in (0, 1))
    turn = first.rotate(second.rotation)
    np.testing.assert_allclose(turn, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(turn @ first.translation, second.translation, atol=1e-12)


def test_free_poses_stand_on_the_table() -> None:
    for pose in range(3):
        seen = thing(pose, turntable=False)
        heights = (seen.pose @ seen.solid.vertices)[:, 2]
        assert 0 < heights.min() < 0.01


def test_matches_triangulate_to_the_surface() -> None:
    seen = thing()
    projector_px, bright, on_thing = seen.seen()
    there = np.isfinite(projector_px[..., 0]) & on_thing
    row, column = np.nonzero(there)
    points = midpoints(
        Matches(np.stack([column, row], axis=1).astype(np.float64), projector_px[there]), seen.calibration
    )
    own = seen.truth.place @ points.T
    apart = np.min(np.linalg.norm(own[::50, None] - seen.solid.vertices, axis=2), axis=1)
    assert 0 < np.median(apart) < 0.001  # vertices are a millimetre apart
    assert 0.05 < there.mean() < 0.5
    assert np.all(bright[there] > 0)


def test_a_file_without_a_mesh_is_refused() -> None:
    with pytest.raises(DeviceError, match="expected a mesh"):
        draw_solid(ThingSettings(kind="file", file="nowhere.ply"), np.random.default_rng(0))
