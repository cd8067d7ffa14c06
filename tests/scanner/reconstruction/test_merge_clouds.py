"""Clouds of several captures in the frame of their corner."""

from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import Corner
from calib.pointcloud import Cloud, CornerView, build_cloud, cells_of, merged
from calib.self_calibration import Profile, SelfCalibration
from scanner.capture import CaptureMetadata
from scanner.reconstruction.merge_clouds import consistency, merge
from scanner.results import Decoded, GivenMatches, SelfCalibrated
from tests.support.cloud_scene import CAMERA, PROJECTOR, Scene, room


@pytest.fixture(scope="module")
def scene() -> Scene:
    return room()


@pytest.fixture(scope="module")
def cloud(scene: Scene) -> Cloud:
    return build_cloud(scene.matches, scene.texture, scene.calibration)


@pytest.fixture(scope="module")
def view(scene: Scene, cloud: Cloud) -> CornerView:
    return CornerView(
        cloud.points, scene.texture.mean(axis=2).astype(np.float32), scene.calibration.camera, scene.corner
    )


def renumbered(corner: Corner, turn: int) -> Corner:
    return Corner(corner.vertex, np.roll(corner.legs, turn, axis=0))


def test_points_are_in_the_corners_frame(cloud: Cloud, view: CornerView) -> None:
    found = merged([cloud], [view], (0,))
    assert found.unit == "m"
    # The eye is at (1.5, 1.3, 1.2) in the room, whose corner is the origin.
    on_a_wall = np.min(np.abs(found.points), axis=1) < 0.01
    assert 0.85 < on_a_wall.mean() < 1
    assert found.points[on_a_wall].min() > -0.01
    for axis in range(3):
        on_face = np.abs(found.points[:, axis]) < 0.005
        assert 0.99 < np.median(found.normals[on_face, axis]) <= 1


def test_a_voxel_holds_at_most_one_point(cloud: Cloud, view: CornerView) -> None:
    found = merged([cloud, cloud], [view, view], (0, 0))
    assert 0.5 * cloud.there.sum() < len(found.points) < cloud.there.sum()
    # A float32 may round a point over the border of its cube.
    assert len(np.unique(cells_of(found.points.astype(float), found.grid))) > 0.999 * len(found.points)
    assert found.grid == pytest.approx(view.distance / CAMERA.focal_px[0])


def test_a_voxel_keeps_the_point_nearest_to_its_camera(cloud: Cloud, view: CornerView) -> None:
    """The second capture is the same from farther away, with black points."""
    away = replace(cloud, points=2 * cloud.points, colours=np.zeros_like(cloud.colours))
    far = replace(view, points=away.points, corner=Corner(2 * view.corner.vertex, view.corner.legs))
    found = merged([cloud, away], [view, far], (0, 0))
    from_first = found.colours.max(axis=1) > 0
    near = np.max(np.abs(found.points), axis=1) < 0.5  # there the first has a point in nearly every cube
    assert from_first[near].mean() > 0.5 > from_first[~near].mean() > 0


@pytest.mark.parametrize("turn", [1, 2])
def test_renumbering_the_legs_gives_the_same_cloud(cloud: Cloud, view: CornerView, turn: int) -> None:
    other = replace(view, corner=renumbered(view.corner, -turn))
    found = merged([cloud, cloud], [view, other], (0, turn))
    alone = merged([cloud, cloud], [view, view], (0, 0))
    np.testing.assert_allclose(found.points, alone.points, atol=1e-6)
    np.testing.assert_allclose(found.normals, alone.normals, atol=1e-6)


def test_a_capture_agrees_with_itself(cloud: Cloud, view: CornerView) -> None:
    apart = consistency([cloud, cloud], [view, view], (0, 0))
    assert len(apart) > 10_000
    assert apart.max() < 1e-6
    shifted = replace(view, corner=Corner(view.corner.vertex * 1.002, view.corner.legs))
    assert 5e-4 < np.median(consistency([cloud, cloud], [view, shifted], (0, 0))) < 3e-3


def found_in(scene: Scene, corner: Corner, photograph: np.ndarray | None) -> SelfCalibrated:
    baseline = scene.calibration.baseline
    solution = SelfCalibration(
        scene.calibration.scaled(1 / baseline, "baseline"),
        scene.matches,
        Corner(corner.vertex / baseline, corner.legs),
        Profile(np.ones(1), np.ones(1)),
        0.1,
        "refined",
    )
    decoded = Decoded(CaptureMetadata(CAMERA.size, PROJECTOR.size), scene.matches, GivenMatches(photograph))
    return SelfCalibrated(decoded, solution, scene.calibration)


def test_captures_are_merged_for_any_order_of_faces(scene: Scene, cloud: Cloud) -> None:
    corners = scene.corner, renumbered(scene.corner, 1)
    found, finding = merge([found_in(scene, corner, scene.texture) for corner in corners], [cloud, cloud])
    assert found is not None
    assert len(found.points) < cloud.there.sum()
    assert finding.kind.name == "merged"
    assert "2 clouds are merged" in finding.message
    assert 0 <= finding.number("apart_share") < 0.01


def test_ambiguous_captures_are_not_merged(scene: Scene, cloud: Cloud) -> None:
    on_walls = np.zeros(cloud.there.shape, np.bool_)
    column, row = scene.matches.camera_px[scene.surface < 3].astype(int).T
    on_walls[row, column] = True
    bare = replace(cloud, points=np.where(on_walls[..., None], cloud.points, np.nan))
    found, finding = merge([found_in(scene, scene.corner, None) for _ in range(2)], [bare, bare])
    assert found is None
    assert finding.kind.name == "not-merged"
    assert "looks the same from three sides" in finding.message


def test_different_corners_are_not_merged(scene: Scene, cloud: Cloud) -> None:
    legs = scene.corner.legs.copy()
    legs[0] += 0.002 * legs[1]
    other = Corner(scene.corner.vertex, legs / np.linalg.norm(legs, axis=1, keepdims=True))
    captures = [found_in(scene, corner, scene.texture) for corner in (scene.corner, other)]
    found, finding = merge(captures, [cloud, cloud])
    assert found is None
    assert finding.kind.name == "not-merged"
    assert "do not show the same corner" in finding.message
