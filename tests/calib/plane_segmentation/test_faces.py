"""Faces in matches of furnished rooms and boxes, compared with the true surfaces.

Faces are found with a known principal point, which is far from the centre of a cropped picture.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.geometry import NO_FACE, Intrinsics, Matches, homogeneous
from calib.numerics import Ints
from calib.plane_segmentation.faces import Faces, find_faces
from calib.refusal import RefusalError
from calib.synthetic import random_capture
from hw.settings import SimulatedRigSettings
from hw.simulated import Label, place_room
from tests.support.room import SPHERE, Ball, Box
from tests.support.scenes import (
    OUTLIER,
    Scene,
    ball,
    box_on_table,
    furnished_room,
    furniture,
    plain_room,
    score,
)
from tests.support.whole_room import observed

CAMERA, PROJECTOR = (480, 270), (854, 480)


def faces_of(scene: Scene) -> Faces:
    return find_faces(scene.matches, size(scene.calibration.camera), size(scene.calibration.projector))


def size(device: Intrinsics) -> tuple[int, int]:
    return device.width, device.height


def refusal_of(scene: Scene) -> RefusalError:
    with pytest.raises(RefusalError) as caught:
        faces_of(scene)
    assert caught.value.advice
    return caught.value


@pytest.fixture(scope="module")
def room() -> Scene:
    return furnished_room(np.random.default_rng(3), scale=0.5)


@pytest.fixture(scope="module")
def faces(room: Scene) -> Faces:
    return faces_of(room)


@pytest.mark.parametrize("seed", range(4))
def test_faces_of_furnished_rooms(seed: int) -> None:
    scene = furnished_room(np.random.default_rng(100 + seed), scale=0.5)
    result = score(scene, faces_of(scene).matches.face)
    assert result.off_square_deg < 0.01
    assert result.wrong < 0.003
    # Outliers, and matches along the creases that both faces explain, get no label.
    assert np.all((result.labelled > 0.85) & (result.labelled < 1))


@pytest.mark.parametrize("seed", range(2))
def test_faces_of_rooms_with_a_hidden_vertex(seed: int) -> None:
    scene = furnished_room(np.random.default_rng(200 + seed), scale=0.5, hidden_vertex=True)
    result = score(scene, faces_of(scene).matches.face)
    assert result.off_square_deg < 0.01
    assert result.wrong < 0.003


@pytest.mark.parametrize("seed", range(2))
def test_faces_of_a_box_seen_from_outside(seed: int) -> None:
    scene = box_on_table(np.random.default_rng(300 + seed), scale=0.5)
    result = score(scene, faces_of(scene).matches.face)
    assert result.off_square_deg < 0.01
    assert result.wrong < 0.003
    assert np.all((result.labelled > 0.85) & (result.labelled < 1))


def test_faces_of_few_noisy_matches_of_a_bare_corner() -> None:
    capture = random_capture(np.random.default_rng(5), count=10_000, noise_px=0.3, outliers=0.05, walls_off_deg=0.3)
    truth = capture.matches.face
    assert truth is not None
    unlabelled = replace(capture.matches, face=None)
    calibration = capture.calibration
    face = find_faces(unlabelled, size(calibration.camera), size(calibration.projector)).matches.face
    assert face is not None
    labelled = face != NO_FACE
    confusion = np.zeros((3, 4))
    np.add.at(confusion, (face[labelled], truth[labelled]), 1)  # the last column counts the outliers, −1
    assert np.sum(confusion) - confusion.max(axis=1).sum() < 0.003 * np.sum(confusion)
    assert 0.85 < np.mean(labelled) < 0.96


def test_faces_are_numbered_by_size(faces: Faces) -> None:
    assert faces.matches.face is not None
    counts = np.bincount(faces.matches.face[faces.matches.face >= 0])
    assert len(counts) == 3
    assert counts[0] >= counts[1] >= counts[2]


def test_planes_agree_with_the_labels(faces: Faces) -> None:
    assert [plane.matches for plane in faces.planes] == np.bincount(faces.plane[faces.plane >= 0]).tolist()
    assert sorted(plane.face for plane in faces.planes if plane.face is not None) == [0, 1, 2]
    for index, plane in enumerate(faces.planes):
        expected = NO_FACE if plane.face is None else plane.face
        assert np.all(faces.matches.face[faces.plane == index] == expected)


def test_nothing_but_labels_is_changed(room: Scene, faces: Faces) -> None:
    assert np.array_equal(faces.matches.camera_px, room.matches.camera_px)
    assert np.array_equal(faces.matches.projector_px, room.matches.projector_px)


def test_the_same_matches_give_the_same_faces(room: Scene, faces: Faces) -> None:
    assert np.array_equal(faces_of(room).plane, faces.plane)


def test_the_order_of_the_matches_does_not_matter(room: Scene, faces: Faces) -> None:
    order = np.random.default_rng(0).permutation(len(room.matches))
    shuffled = faces_of(replace(room, matches=room.matches[order], surface=room.surface[order]))
    assert agreement(shuffled.matches.face, faces.matches.face[order]) > 0.995


def test_single_precision_is_enough(room: Scene, faces: Faces) -> None:
    matches = room.matches
    sigma_px: Any = (
        np.ones(len(matches), np.float32) if matches.sigma_px is None else matches.sigma_px.astype(np.float32)
    )
    single = Matches(matches.camera_px.astype(np.float32), matches.projector_px.astype(np.float32), None, sigma_px)
    found = find_faces(single, size(room.calibration.camera), size(room.calibration.projector))
    assert agreement(found.matches.face, faces.matches.face) > 0.995
    assert found.matches.camera_px.dtype == np.float32


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_unit_of_the_camera_pixels_does_not_matter(room: Scene, faces: Faces, factor: float) -> None:
    camera = room.calibration.camera
    scaled = replace(room.matches, camera_px=(room.matches.camera_px + 0.5) * factor - 0.5)
    sizes = (round(camera.width * factor), round(camera.height * factor)), size(room.calibration.projector)
    assert agreement(find_faces(scaled, *sizes).matches.face, faces.matches.face) > 0.99


def agreement(one: Ints | None, other: Ints | None) -> float:
    assert one is not None
    assert other is not None
    return float(np.mean(one == other))


def test_a_wall_on_both_sides_of_a_pillar_is_one_plane() -> None:
    pillar = Box(np.array([0.75, 0.15, 1.0]), np.array([0.15, 0.3, 2.0]))
    scene = plain_room(np.random.default_rng(1), boxes=(pillar,), look_at=(0.5, 0.0, 0.2))
    plane = faces_of(scene).plane
    on_wall = (scene.surface == 1) & (plane >= 0)
    in_the_way = scene.matches.camera_px[(scene.surface >= 3)][:, 0]
    left = scene.matches.camera_px[:, 0] < in_the_way.min()
    right = scene.matches.camera_px[:, 0] > in_the_way.max()
    assert np.count_nonzero(on_wall & left) > 1000
    assert np.count_nonzero(on_wall & right) > 1000
    assert len(np.unique(plane[on_wall & left])) == len(np.unique(plane[on_wall & right])) == 1
    assert plane[on_wall & left][0] == plane[on_wall & right][0]


def test_smaller_walls_win_against_a_rotated_box() -> None:
    # Its front is larger than the wall behind it and 12 degrees off it.
    box = Box(np.array([0.75, 0.55, 0.3]), np.array([0.7, 0.3, 0.6]), 0.2)
    scene = plain_room(np.random.default_rng(2), boxes=(box,), look_at=(0.55, 0.4, 0.25))
    result = score(scene, faces_of(scene).matches.face)
    assert result.off_square_deg < 0.01
    assert result.wrong < 0.003


def test_a_sphere_is_no_face() -> None:
    sphere = Ball(np.array([0.5, 0.45, 0.25]), 0.25)
    scene = plain_room(np.random.default_rng(3), sphere=sphere, look_at=(0.3, 0.3, 0.0))
    face = faces_of(scene).matches.face
    on_sphere = scene.surface == SPHERE
    assert np.count_nonzero(on_sphere) > 2000
    assert np.mean(face[on_sphere] != NO_FACE) < 0.01


def test_outliers_get_no_label(room: Scene, faces: Faces) -> None:
    wrong = room.surface == OUTLIER
    assert np.count_nonzero(wrong) > 100
    assert np.mean(faces.plane[wrong] >= 0) < 0.02


def test_without_distortion_faces_follow_homographies() -> None:
    scene = plain_room(np.random.default_rng(4), lens_k1=0.0)
    faces = faces_of(scene)
    for index, plane in enumerate(faces.planes):
        on = scene.matches[faces.plane == index]
        mapped = np.concatenate([on.camera_px, np.ones((len(on), 1))], axis=1) @ plane.homography.T
        error = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - on.projector_px, axis=1)
        # The noise alone has a median length of 0.118 px.
        assert 0.1 < np.median(error) < 0.2


def test_a_flat_wall_is_refused() -> None:
    scene = plain_room(np.random.default_rng(5), (True, False, False), look_at=(0.0, 0.8, 0.8))
    assert "one plane" in refusal_of(scene).reason


def test_a_floor_with_a_ball_is_refused() -> None:
    rng = np.random.default_rng(6)
    scene = plain_room(rng, (False, False, True), sphere=ball(rng, 3.0), look_at=(0.6, 0.6, 0.0))
    assert "one plane" in refusal_of(scene).reason


def test_two_planes_are_refused() -> None:
    scene = plain_room(np.random.default_rng(7), (True, False, True), look_at=(0.0, 0.6, 0.0))
    assert "two planes" in refusal_of(scene).reason


def test_no_baseline_is_refused() -> None:
    scene = plain_room(np.random.default_rng(8), baseline=1e-4)
    assert "where the camera stands" in refusal_of(scene).reason


def test_a_corner_that_is_not_square_is_refused() -> None:
    # Oblong projector pixels are what a skewed corner looks like to who takes it for a square one.
    rng = np.random.default_rng(9)
    scene = plain_room(rng, boxes=furniture(rng, 2.5, hides_vertex=False))
    stretched = replace(scene.matches, projector_px=scene.matches.projector_px * (1.25, 1.0))
    with pytest.raises(RefusalError, match="perpendicular") as caught:
        find_faces(stretched, size(scene.calibration.camera), (1068, 480))
    assert "diamond" not in str(caught.value)


def test_pixels_of_a_diamond_array_are_told() -> None:
    """The columns of the matches' projector are twice as wide as its rows are high."""
    scene = plain_room(np.random.default_rng(9))
    width, height = size(scene.calibration.projector)
    oblong = replace(scene.matches, projector_px=scene.matches.projector_px * (0.5, 1.0) - (0.25, 0.0))
    with pytest.raises(RefusalError, match="twice as wide as high, as in a diamond array") as caught:
        find_faces(oblong, size(scene.calibration.camera), (width // 2, height))
    assert "--pixel-aspect 0.5" in caught.value.advice


@pytest.mark.parametrize(("seed", "oblong_percent"), [(101, 17), (102, 16)])
def test_a_box_under_keystone_correction_is_not_taken_for_a_corner(seed: int, oblong_percent: int) -> None:
    # Some three planes are a corner before square pixels by chance; before oblong ones the walls are, all is square.
    scene = furnished_room(np.random.default_rng(seed), scale=0.5)
    assert faces_of(scene).planes[2].face is not None
    with pytest.raises(RefusalError, match=f"oblong or skewed by {oblong_percent}%") as caught:
        find_faces(keystoned(scene, 0.2), size(scene.calibration.camera), size(scene.calibration.projector))
    assert "keystone" in caught.value.advice


def keystoned(scene: Scene, narrower: float) -> Matches:
    """Matches of a picture with keystone: its top edge is narrower by this share than its bottom edge."""
    width, height = size(scene.calibration.projector)
    lean = (1 / (1 - narrower) - 1) / 2
    shape = np.linalg.inv(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -lean, 1 + lean]]))
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    shown = homogeneous((scene.matches.projector_px - centre) / (height / 2)) @ shape.T
    return replace(scene.matches, projector_px=shown[:, :2] / shown[:, 2:] * (height / 2) + centre)


def test_scattered_matches_are_refused() -> None:
    scene = plain_room(np.random.default_rng(10))
    anywhere = np.random.default_rng(0).uniform((0, 0), (854, 480), scene.matches.projector_px.shape)
    assert "not smooth" in refusal_of(replace(scene, matches=replace(scene.matches, projector_px=anywhere))).reason


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_few_matches_are_refused(room: Scene, count: int) -> None:
    with pytest.raises(RefusalError, match=f"Only {count} matches"):
        find_faces(room.matches[:count], (612, 512), (854, 480))


def test_matches_in_one_line_are_refused() -> None:
    x = np.linspace(0, 1223, 20_000)
    line = np.stack([x, np.full(len(x), 500.0)], axis=1)
    with pytest.raises(RefusalError):
        find_faces(Matches(line, line * 0.5), (1224, 1024), (854, 480))


def test_with_a_known_principal_point_a_box_is_not_taken_for_a_wall() -> None:
    """The camera shows the upper two thirds of its sensor; rotated boxes stand in front of the corner."""
    room = place_room(SimulatedRigSettings(seed=15), CAMERA, PROJECTOR)
    seen = observed(room, np.random.default_rng(0), 0.05)
    point = seen.calibration.camera.principal_point_px
    assert abs(point[1] - (CAMERA[1] - 1) / 2) > 70
    found = find_faces(seen.matches, CAMERA, PROJECTOR, point).matches.face
    assert found is not None
    label = seen.scene.labels[seen.surface]
    assert 0.97 < np.mean(label[found >= 0] <= Label.FLOOR) <= 1
    for face in range(3):
        (mostly, share) = np.unique(label[found == face], return_counts=True)
        assert share.max() / share.sum() > 0.97, mostly
