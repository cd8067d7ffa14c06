"""Walls, furniture, rig and poses drawn from the seed, without light."""

import numpy as np
import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated.placement import look
from hw.simulated.room import DrawnRoom, _corner, draw_room, draw_walls
from hw.simulated.scene import Label
from hw.simulated.shapes import Block
from hw.simulated.simulation import true_calibration

SEEDS = range(10)


def drawn(seed: int, **settings: object) -> DrawnRoom:
    return draw_room(SimulatedRigSettings.model_validate({"seed": seed, **settings}))


def angles_deg(walls: Block) -> list[float]:
    """The three angles between the faces of the corner."""
    x, y, floor = -walls.outward_normals[:3]
    return [180 - np.degrees(np.arccos(a @ b)) for a, b in ((floor, x), (floor, y), (x, y))]


@pytest.mark.parametrize("seed", SEEDS)
def test_views_show_all_faces_and_the_sphere(seed: int) -> None:
    room = drawn(seed)
    view = look(room.scene, room.camera, room.projector)
    assert 0.15 <= view.label_shares[:3].min() <= view.label_shares[:3].max() < 0.6
    assert 0.04 <= view.label_shares[Label.FURNITURE] < 0.5
    assert 0.005 < view.label_shares[Label.SPHERE] < 0.1
    assert view.sphere_lit > 0.8
    assert view.picture_in_frame > 0.98
    assert 0.2 < view.baseline_out_of_face < 0.6
    assert view.forward < 0.5
    assert not view.vertex_hidden
    assert 0.3 <= true_calibration(room).baseline <= 0.6
    assert 2.0 <= np.linalg.norm(room.camera.centre) <= 3.4


@pytest.mark.parametrize("seed", SEEDS)
def test_hide_vertex_hides_the_vertex_but_not_the_faces(seed: int) -> None:
    room = drawn(seed, hide_vertex=True)
    view = look(room.scene, room.camera, room.projector)
    assert view.vertex_hidden
    assert view.label_shares[:3].min() >= 0.15


@pytest.mark.parametrize("seed", SEEDS)
def test_walls_are_square_unless_asked_otherwise(seed: int) -> None:
    np.testing.assert_allclose(angles_deg(drawn(seed).scene.room), 90.0, atol=1e-9)


def test_walls_deviate_by_the_configured_standard_deviation() -> None:
    rng = np.random.default_rng(5)
    off = np.array([angles_deg(draw_walls(rng, 0.3)) for _ in range(400)]) - 90
    assert np.all((off.std(axis=0) > 0.27) & (off.std(axis=0) < 0.33))
    assert np.all(np.abs(off.mean(axis=0)) < 0.06)
    assert np.abs(np.corrcoef(off.T)[np.triu_indices(3, 1)]).max() < 0.2


def test_the_floor_stays_level_and_the_room_closed() -> None:
    walls = draw_walls(np.random.default_rng(3), 2.0)
    np.testing.assert_allclose(walls.outward_normals[2], [0, 0, -1], atol=1e-12)
    assert np.abs(np.array(angles_deg(walls)) - 90).max() > 0.5
    assert np.linalg.det(walls.edges) > 0


def test_the_rig_moves_and_the_room_does_not() -> None:
    places = [drawn(2, pose=pose, walls_off_deg=0.3) for pose in range(4)]
    calibrations = [true_calibration(place) for place in places]
    for i, (place, calibration) in enumerate(zip(places, calibrations, strict=True)):
        assert place.camera.optics == places[0].camera.optics
        assert place.projector.optics == places[0].projector.optics
        np.testing.assert_allclose(calibration.pose.rotation, calibrations[0].pose.rotation, atol=1e-12)
        np.testing.assert_allclose(calibration.pose.translation, calibrations[0].pose.translation, atol=1e-12)
        np.testing.assert_array_equal(place.scene.room.edges, places[0].scene.room.edges)
        assert len(place.scene.blocks) == len(places[0].scene.blocks) == 4
        for block, first in zip(place.scene.blocks, places[0].scene.blocks, strict=True):
            np.testing.assert_array_equal(block.edges, first.edges)
        view = look(place.scene, place.camera, place.projector)
        assert view.is_suitable(0.15)
        assert all(np.linalg.norm(place.camera.centre - other.camera.centre) > 0.35 for other in places[:i])


def test_the_seed_determines_the_room() -> None:
    first, other = drawn(7), drawn(8)
    _corner.cache_clear()
    again = drawn(7)
    np.testing.assert_array_equal(first.camera.centre, again.camera.centre)
    assert first.camera.optics == again.camera.optics
    assert np.linalg.norm(first.camera.centre - other.camera.centre) > 0.01
    assert first.camera.optics.k1 != other.camera.optics.k1


def test_lenses_are_ordinary_or_ideal() -> None:
    for seed in SEEDS:
        room = drawn(seed)
        assert -0.06 < room.camera.optics.k1 < -0.01
        assert -0.03 < room.projector.optics.k1 < 0.01
    ideal = drawn(0, distortion=0.0)
    assert (ideal.camera.optics.k1, ideal.projector.optics.k1) == (0.0, 0.0)


def test_solids_stand_in_the_room_without_intersecting() -> None:
    for seed in SEEDS:
        scene = drawn(seed, sphere_radius_m=0.1).scene
        assert scene.sphere is not None
        assert scene.sphere.radius == 0.1
        assert scene.sphere.centre[2] == 0.1
        # Points just above each lid's middle are in the air unless another box stands there.
        lids = np.stack(
            [b.origin + b.edges.sum(axis=0) - 0.5 * (b.edges[0] + b.edges[1]) for b in scene.blocks], axis=1
        )
        free = scene.is_free(lids + np.array([[0.0], [0.0], [0.01]]))
        assert free.tolist() == [False, True, True, True]


def test_without_furniture_the_room_is_empty() -> None:
    scene = drawn(0, furniture=False).scene
    assert scene.blocks == ()
    assert scene.sphere is None
