"""A whole room with non-parallel walls, and one unchanged rig at all its stations."""

from itertools import pairwise

import numpy as np
import pytest

from hw.errors import DeviceError
from hw.open_rig import at_place
from hw.settings import SimulatedRigSettings
from hw.simulated.placement import lit_and_visible, seen
from hw.simulated.room import draw_room
from tests.support.whole_room import stations

ROOM = {"room": "whole", "walls_off_deg": 0.3, "furniture_askew_deg": 4.0}


@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_each_station_sees_a_third_of_the_next_one_and_the_rig_is_unchanged(seed: int) -> None:
    rooms = [draw_room(SimulatedRigSettings.model_validate({**ROOM, "seed": seed, "pose": k})) for k in range(6)]
    for room, following in pairwise([*rooms, rooms[0]]):
        assert room.camera.optics == rooms[0].camera.optics
        points, surface, lit = seen(following.scene, following.camera, following.projector)
        assert 0.3 < lit.mean() < 0.95
        shared = lit_and_visible(room.scene, room.camera, room.projector, surface[lit], points[:, lit])
        assert 0.25 <= shared.mean() < 0.6
        assert np.linalg.norm(room.camera.centre - following.camera.centre) > 0.3


def test_opposite_walls_are_not_parallel_and_every_match_is_where_a_ray_met_a_surface() -> None:
    found = stations(4, camera=(153, 128), noise_px=0.0)
    scene = found[0].scene
    across = [
        -scene.blocks[wall].outward_normals[0] @ scene.room.outward_normals[axis] for wall, axis in ((0, 0), (3, 1))
    ]
    off_deg = 180 - np.degrees(np.arccos(across))
    assert np.all((off_deg > 0.02) & (off_deg < 3.0))
    for station in found:
        world = station.place @ station.points
        normals = scene.normals(station.surface, world.T)
        back = scene.points_on(int(station.surface[0]), scene.surface_coordinates(station.surface[:1], world[:1].T))
        np.testing.assert_allclose(back[:, 0], world[0], atol=1e-9)
        assert np.all(np.sum(normals.T * (station.place.translation - world), axis=1) > 0)
        thrown = station.calibration.pose @ station.points
        assert np.all(thrown[:, 2] > 0)


def test_every_station_has_a_pose() -> None:
    settings = SimulatedRigSettings.model_validate({"room": "whole", "stations": 10, "pose": 8})
    assert at_place(settings, 1) == settings.model_copy(update={"pose": 9})
    with pytest.raises(DeviceError, match="poses 0 to 9"):
        at_place(settings, 2)
    with pytest.raises(ValueError, match="pose: expected 0 to 7, found 8"):
        SimulatedRigSettings.model_validate({"pose": 8})
