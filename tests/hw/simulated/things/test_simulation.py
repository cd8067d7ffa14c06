"""A simulated thing: its shape, its poses, and its ground truth."""

import numpy as np
import pytest

from calib.geometry import Matches, midpoints
from hw.errors import DeviceError
from hw.settings import SimulatedRigSettings, ThingSettings
from hw.simulated.things import SimulatedThing
from hw.simulated.things.stage import draw_solid

CAMERA, PROJECTOR = (153, 128), (427, 240)


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
