"""A result folder for display, compared with its scene.

A network to look at: every device where its file says, and the cloud in the same frame.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.diagnostics import Uncertainty
from calib.geometry import intersect
from calib.pointcloud import point_covariances
from calib.refinement import SHARED, State
from scanner.errors import InputError
from scanner.io import read_calibration, write_calibration
from scanner.rendering import frustum_lines
from scanner.results import Verdict, confidence_entries
from scanner.viewing.colouring import Colouring, coloured, possible_colourings
from scanner.viewing.geometry import (
    FIELD_OF_VIEW_RAD,
    nice_step,
    picture_corners,
    ruler_lines,
    viewpoint,
)
from scanner.viewing.result import ALL_CAPTURES, CaptureCloud, ViewedResult, network_cloud
from tests.support.cloud_scene import room
from tests.support.mapped_room import write_network
from tests.support.result_folder import Written, corner_pose, write_captures, write_result
from tests.support.states import device_of


@pytest.fixture(scope="module")
def cloud(written: Written) -> CaptureCloud:
    result = ViewedResult(written.folder)
    assert result.names == ("The capture",)
    shown = result.cloud("The capture")
    assert isinstance(shown, CaptureCloud)
    return shown


def test_the_corner_has_its_true_pose(written: Written, cloud: CaptureCloud) -> None:
    assert cloud.corner is not None
    found, true = cloud.corner.corner, written.scene.corner
    assert 1e-7 < np.linalg.norm(found.vertex - true.vertex) < 0.001
    assert np.min(np.sum(found.legs * true.legs, axis=1)) > 0.99999
    for angle in cloud.corner.scene.angles:
        assert 1e-6 < abs(angle.angle_deg - 90) < 0.05


def test_outlines_start_at_the_vertex_and_enclose_their_points(written: Written, cloud: CaptureCloud) -> None:
    assert cloud.corner is not None
    for face, outline in enumerate(cloud.corner.outlines):
        origin, first, _, second = outline
        assert np.allclose(origin, cloud.corner.corner.vertex)
        edges = np.stack([first - origin, second - origin], axis=1)
        points = cloud.points[cloud.matches.face == face] - origin
        share = np.linalg.lstsq(edges, points.T, rcond=None)[0]
        assert 0.98 < np.mean(np.all((share > -0.02) & (share <= 1), axis=0)) < 1


def test_the_up_direction_is_vertical(written: Written, cloud: CaptureCloud) -> None:
    assert cloud.up @ written.scene.corner.legs[2] > 0.9999  # the scene's z axis, and its camera is upright


def test_the_initial_view_shows_cloud_and_devices_from_behind_the_camera(cloud: CaptureCloud) -> None:
    view = viewpoint(cloud)
    (rig,) = cloud.rigs
    forward = (view.target - view.position) / np.linalg.norm(view.target - view.position)
    right = np.cross(forward, view.up) / np.linalg.norm(np.cross(forward, view.up))
    for point in (rig.position, rig.projector_centre, *cloud.points[::997]):
        seen = point - view.position
        assert seen @ forward > 0
        for side in (right, np.cross(right, forward)):
            assert abs(seen @ side) < np.tan(FIELD_OF_VIEW_RAD / 2) * (seen @ forward)
    ahead = np.median(cloud.points, axis=0)
    assert (rig.position - view.position) @ ahead > 0, "behind the camera"
    assert (view.position - rig.position) @ view.up > 0, "above it"


def test_points_can_be_coloured_by_every_known_quantity(written: Written, cloud: CaptureCloud) -> None:
    colourings = possible_colourings(cloud)
    assert set(colourings) == {*Colouring} - {Colouring.REFERENCE}, "that of deviations"
    chosen = cloud.order[:1000]
    for colouring in colourings:
        told = coloured(cloud, chosen, colouring)
        assert told.colours.shape == (1000, 3)
        assert told.colours.dtype == np.uint8
        assert told.legend
    face = cloud.matches.face[chosen]
    colours = coloured(cloud, chosen, Colouring.FACES).colours
    assert len({tuple(colour) for colour in colours[face == 1]}) == 1
    assert len({tuple(colour) for colour in colours}) == len(np.unique(face))


def test_distances_from_the_faces_match_the_flatness(cloud: CaptureCloud) -> None:
    off = cloud.from_faces(np.arange(len(cloud.points)))
    assert np.array_equal(np.isfinite(off), np.isin(cloud.matches.face, (0, 1, 2)))
    for label, face in enumerate(cloud.scene.faces):
        on = cloud.matches.face == label
        assert np.sqrt(np.mean(off[on] ** 2)) == pytest.approx(face.errors.rms, rel=0.05)
    nearer = cloud.points * 0.999  # towards the camera
    assert np.median(replace(cloud, points=nearer).from_faces(np.arange(len(off)))[np.isfinite(off)]) > 0
    told = coloured(cloud, np.arange(len(off)), Colouring.DEVIATION)
    assert told.bar is not None
    assert told.bar.low == told.bar.high.replace("+", "−")
    signs = told.colours.astype(int)[..., 0] - told.colours[..., 2]  # red above, blue below
    strong = np.abs(np.nan_to_num(off)) > np.nanquantile(np.abs(off), 0.5)
    assert np.array_equal(np.sign(signs[strong]), np.sign(off[strong]))


def test_depth_sigmas_match_the_errors(written: Written, cloud: CaptureCloud) -> None:
    chosen = cloud.order[:5000]
    true = {
        tuple(pixel): point for pixel, point in zip(written.scene.matches.camera_px, written.scene.points, strict=True)
    }
    depth = np.array([true[tuple(pixel)][2] for pixel in cloud.matches.camera_px[chosen]])
    errors = (cloud.points[chosen, 2] - depth) / cloud.depth_sigma(chosen)
    # Of the two coordinates' noise, the part along the epipolar line moves the point.
    assert 0.9 < np.sqrt(np.mean(errors**2)) < 1.1


def test_depth_sigmas_include_the_calibration(tmp_path: Path) -> None:
    """For a result with a covariance, here of the camera's focal length alone."""
    written = write_result(tmp_path / "room", noise_px=0.005)
    calibration = read_calibration(written.folder / "calibration.yaml")
    covariance = np.zeros((SHARED, SHARED))
    covariance[0, 0] = 0.001**2
    state = State(device_of(calibration.camera), device_of(calibration.projector), calibration.pose.in_baselines)
    more = confidence_entries(Verdict("good", "Well", ("so",)), Uncertainty(state, covariance, None, 0.05))
    write_calibration(written.folder / "calibration.yaml", calibration, more)
    result = ViewedResult(written.folder)
    assert result.verdict == Verdict("good", "Well", ("so",))
    cloud = result.cloud("The capture")
    assert isinstance(cloud, CaptureCloud)
    chosen = cloud.order[:2000]
    noise = np.sqrt(point_covariances(cloud.matches[chosen], calibration)[:, 2, 2])
    camera = replace(calibration.camera, focal_px=(1.001 * calibration.camera.focal_px[0],) * 2)
    moved = intersect(cloud.matches[chosen], replace(calibration, camera=camera)).points[:, 2]
    expected = np.hypot(noise, moved - cloud.points[chosen, 2])
    assert np.median(expected / noise) > 2
    ratio = cloud.depth_sigma(chosen) / expected
    # The rays that no longer meet are taken to meet halfway, and here where the camera's is nearest to the other.
    assert 0.9 < np.quantile(ratio, 0.05) < np.quantile(ratio, 0.95) < 1.1
    assert "covariance" in coloured(cloud, chosen, Colouring.SIGMA).legend


def test_without_faces_and_sigmas_there_is_still_a_cloud(tmp_path: Path, edit_matches: Callable[..., None]) -> None:
    folder = write_result(tmp_path / "room").folder
    edit_matches(folder, drop=("face", "sigma_px"))
    cloud = ViewedResult(folder).cloud("The capture")
    assert cloud.corner is None
    assert possible_colourings(cloud) == (Colouring.CAMERA, Colouring.DEPTH)
    assert np.array_equal(cloud.up, [0, -1, 0])
    assert np.all(np.isfinite(viewpoint(cloud).position))


@pytest.fixture
def edit_matches() -> Callable[..., None]:
    def edit(folder: Path, drop: tuple[str, ...]) -> None:
        with np.load(folder / "matches.npz") as arrays:
            kept = {name: arrays[name] for name in arrays.files if name not in drop}
        np.savez(folder / "matches.npz", **kept)

    return edit


def test_rigs_are_placed_into_the_merged_cloud(tmp_path: Path) -> None:
    older, newer = write_captures(tmp_path / "corner")
    result = ViewedResult(tmp_path / "corner")
    assert result.names == (ALL_CAPTURES, "Capture 2", "Capture 1")
    merged = result.cloud(ALL_CAPTURES)
    for rig, written in zip(merged.rigs, (newer, older), strict=True):
        assert np.allclose(rig.position, corner_pose(written).translation, atol=1e-6)
        assert rig.picture is not None
    assert merged.corner is not None
    assert np.abs(merged.rigs[0].pose @ merged.corner.corner.vertex).max() < 0.002  # the origin of the merged cloud
    assert abs(merged.up[2]) == 1
    assert possible_colourings(merged) == (Colouring.CAMERA,)
    with pytest.raises(ValueError, match="cannot be coloured"):
        coloured(merged, merged.order[:5], Colouring.FACES)
    # A click on a point of the older capture measures in that capture.
    assert merged.scans is not None
    number = merged.point_number(5)
    assert (number.station, number.point) == (0, 5)
    assert np.allclose(merged.scans.position(number), merged.points[5], atol=1e-5)


def test_earlier_captures_are_found(tmp_path: Path) -> None:
    folder = write_result(tmp_path / "room").folder
    for number in ("1", "2"):
        write_result(folder / "captures" / number)
    assert ViewedResult(folder).names == ("Capture 3", "Capture 2", "Capture 1")


def test_a_folder_that_is_no_result_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a result folder"):
        ViewedResult(tmp_path / "nothing")
    folder = write_result(tmp_path / "room").folder
    write_calibration(folder / "calibration.yaml", replace(room().calibration, unit="baseline"))
    (folder / "cloud.ply").write_bytes(b"ply\n")
    with pytest.raises(InputError, match=r"cloud\.ply"):
        ViewedResult(folder).cloud("The capture")


def test_frusta_end_at_the_scene() -> None:
    camera = room().calibration.camera
    corners = picture_corners(replace(camera, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)), 2.0)
    assert np.all(corners[:, 2] == 2.0)
    seen = replace(camera, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)).project(corners)
    right, bottom = camera.width - 0.5, camera.height - 0.5
    assert np.allclose(seen, [[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    lines = frustum_lines(corners)
    assert lines.shape == (8, 2, 3)
    assert np.all(lines[:4, 0] == 0)


@pytest.mark.parametrize(
    ("length", "step"), [(1.0, 0.2), (2.0, 0.5), (4.0, 1.0), (9.9, 2.0), (0.041, 0.01), (1700, 200)]
)
def test_rulers_have_nice_steps(length: float, step: float) -> None:
    assert nice_step(length) == pytest.approx(step)
    lines = ruler_lines(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), length)
    assert len(lines) == 2 + int(length / step + 1e-9)
    assert np.max(lines) <= length


def test_every_device_is_where_the_file_says(tmp_path: Path) -> None:
    folder = write_network(tmp_path / "hall", np.random.default_rng(0))
    devices = {each["name"]: each for each in yaml.safe_load((folder / "network.yaml").read_text())["devices"]}

    viewed = network_cloud(folder)

    assert len(viewed.points) > 1000
    assert {name for rig in viewed.rigs for name in rig.names or ()} == {*devices}
    for rig in viewed.rigs:
        camera, projector = (devices[name] for name in rig.names or ())
        np.testing.assert_allclose(rig.position, camera["translation"])
        np.testing.assert_allclose(rig.projector_centre, projector["translation"], atol=1e-9)
        ahead = rig.pose.rotation @ rig.calibration.pose.rotation.T  # of the projector, in the network's frame
        np.testing.assert_allclose(ahead, projector["rotation"], atol=1e-9)
        assert rig.calibration.camera.focal_px == tuple(camera["focal_px"])


def test_network_without_a_projector_is_refused(tmp_path: Path) -> None:
    folder = write_network(tmp_path / "hall", np.random.default_rng(0))
    document = yaml.safe_load((folder / "network.yaml").read_text())
    for each in document["devices"]:
        each["kind"] = "camera"
    (folder / "network.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match="expected a camera and a projector"):
        network_cloud(folder)
