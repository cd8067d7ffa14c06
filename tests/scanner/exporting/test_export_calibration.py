"""`scan export` to OpenCV and COLMAP, read with their own libraries."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.geometry import Intrinsics
from scanner.commands import main
from tests.support.cloud_scene import PROJECTOR
from tests.support.result_folder import Written, write_result


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("calibration") / "room")


class OpenCV:
    """What an independent program reads from the file."""

    def __init__(self, path: Path) -> None:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        assert storage.isOpened()
        self.camera, self.projector, self.R, self.T = (
            storage.getNode(name).mat() for name in ("camera_matrix", "projector_matrix", "R", "T")
        )
        self.camera_lens, self.projector_lens = (
            storage.getNode(f"{name}_distortion").mat() for name in ("camera", "projector")
        )
        self.camera_size, self.projector_size = (
            tuple(int(storage.getNode(f"{name}_{side}").real()) for side in ("width", "height"))
            for name in ("camera", "projector")
        )
        self.unit = storage.getNode("unit").string()


@pytest.fixture(scope="module")
def opencv(written: Written) -> OpenCV:
    out = written.folder.with_name("calibration.yaml")
    assert main(["export", str(written.folder), "--to", "opencv", "--out", str(out), "--quiet"]) == 0
    return OpenCV(out)


def test_opencv_reads_the_same_values(written: Written, opencv: OpenCV) -> None:
    calibration = written.scan.calibration
    assert np.array_equal(opencv.camera, calibration.camera.matrix)
    assert np.array_equal(opencv.projector_lens.ravel(), calibration.projector.distortion)
    assert np.array_equal(opencv.R, calibration.pose.rotation)
    assert np.array_equal(opencv.T.ravel(), calibration.pose.translation)
    assert opencv.camera_size == (calibration.camera.width, calibration.camera.height)
    assert opencv.projector_size == (calibration.projector.width, calibration.projector.height)
    assert opencv.unit == "m"


def test_opencv_triangulates_the_cloud(written: Written, opencv: OpenCV) -> None:
    matches = written.scan.matches
    camera = cv2.undistortPoints(matches.camera_px[:, None], opencv.camera, opencv.camera_lens)
    projector = cv2.undistortPoints(matches.projector_px[:, None], opencv.projector, opencv.projector_lens)
    looks = np.eye(3, 4), np.hstack([opencv.R, opencv.T])
    homogeneous = cv2.triangulatePoints(*looks, camera[:, 0].T, projector[:, 0].T)
    error = np.linalg.norm((homogeneous[:3] / homogeneous[3]).T - written.scan.points, axis=1)
    # The linear method and the midpoint differ where the rays miss each other, by less than a millimetre in 2.5 m.
    assert 1e-7 < np.median(error) < 1e-4
    assert error.max() < 2e-3


def test_opencv_rectifies_to_equal_rows(written: Written, opencv: OpenCV) -> None:
    matches = written.scan.matches
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        opencv.camera,
        opencv.camera_lens,
        opencv.projector,
        opencv.projector_lens,
        opencv.camera_size,
        opencv.R,
        opencv.T,
    )
    first = cv2.undistortPoints(matches.camera_px[:, None], opencv.camera, opencv.camera_lens, R=R1, P=P1)[:, 0]
    second = cv2.undistortPoints(matches.projector_px[:, None], opencv.projector, opencv.projector_lens, R=R2, P=P2)[
        :, 0
    ]
    along = 0 if abs(P2[0, 3]) > abs(P2[1, 3]) else 1
    miss = (first - second)[:, 1 - along]
    assert 0.001 < np.sqrt(np.mean(miss**2)) < 0.1
    assert np.ptp((first - second)[:, along]) > 20


def test_opencv_undistorts_an_image(written: Written, opencv: OpenCV) -> None:
    """The values of the image are its columns, so the undistorted image shows the column that the lens moved there."""
    camera = written.scan.calibration.camera
    columns, rows = np.meshgrid(np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32))
    straight = cv2.undistort(columns, opencv.camera, opencv.camera_lens)
    pinhole = replace(camera, distortion=(0.0,) * 5)
    expected = camera.project(pinhole.unproject(np.stack([columns, rows], axis=-1).astype(np.float64)))[..., 0]
    middle = (slice(60, -60), slice(60, -60))
    error = np.abs(straight - expected)[middle]
    assert 1e-4 < error.max() < 0.05
    assert np.abs(straight - columns)[middle].max() > 0.5


@pytest.fixture(scope="module")
def model(written: Written) -> Path:
    out = written.folder.with_name("colmap")
    assert main(["export", str(written.folder), "--to", "colmap", "--out", str(out), "--quiet"]) == 0
    return out


def test_colmap_projects_the_points_to_our_pixels(written: Written, model: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    reconstruction = pycolmap.Reconstruction(str(model))
    assert 5_000 < reconstruction.num_points3D() <= 20_000
    assert reconstruction.num_images() == 2
    points = {key: point.xyz for key, point in reconstruction.points3D.items()}
    for image, pixels in (
        ("camera.png", written.scan.matches.camera_px),
        ("projector.png", written.scan.matches.projector_px),
    ):
        seen = next(found for found in reconstruction.images.values() if found.name == image)
        error = np.array([seen.project_point(points[p.point3D_id]) - p.xy for p in seen.points2D])
        assert 1e-4 < np.sqrt(np.mean(error**2)) < 0.1
        assert np.abs(error.mean(axis=0)).max() < 0.005
        corner = np.array([p.xy for p in seen.points2D]) - 0.5
        assert all(np.abs(pixels - at).sum(axis=1).min() < 1e-3 for at in corner[::1000])
    assert 1e-4 < reconstruction.compute_mean_reprojection_error() < 0.1


def test_colmap_pixels_are_offset_by_half_a_pixel(written: Written, model: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    reconstruction = pycolmap.Reconstruction(str(model))
    ours = written.scan.calibration
    for number, device in ((1, ours.camera), (2, ours.projector)):
        theirs = reconstruction.cameras[number]
        assert theirs.model.name == "OPENCV"
        assert (theirs.width, theirs.height) == (device.width, device.height)
        ray = np.array([0.21, -0.13, 1.0])
        assert np.allclose(theirs.img_from_cam(ray), device.project(ray) + 0.5, atol=1e-9)
    pose = reconstruction.images[2].cam_from_world()
    assert np.allclose(pose.rotation.matrix(), ours.pose.rotation, atol=1e-12)
    assert np.allclose(pose.translation, ours.pose.translation, atol=1e-12)
    assert np.allclose(reconstruction.images[1].cam_from_world().matrix(), np.eye(3, 4))


def test_colmap_colours_and_tracks(written: Written, model: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    reconstruction = pycolmap.Reconstruction(str(model))
    scan = written.scan
    for key in list(reconstruction.point3D_ids())[::500]:
        point = reconstruction.points3D[key]
        nearest = int(np.argmin(np.linalg.norm(scan.points - point.xyz, axis=1)))
        assert np.array_equal(point.color, scan.colours[nearest])
        seen = {
            element.image_id: reconstruction.images[element.image_id].points2D[element.point2D_idx].xy
            for element in point.track.elements
        }
        assert np.allclose(seen[1] - 0.5, scan.matches.camera_px[nearest], atol=1e-3)
        assert np.allclose(seen[2] - 0.5, scan.matches.projector_px[nearest], atol=1e-3)


def test_a_third_radial_term_needs_the_full_opencv_model_of_colmap(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    lens = Intrinsics(854, 480, PROJECTOR.focal_px, PROJECTOR.principal_point_px, (0.02, -0.01, 1e-3, -2e-3, 0.03))
    written = write_result(tmp_path / "room", projector=lens)
    assert main(["export", str(written.folder), "--to", "colmap", "--out", str(tmp_path / "m"), "--quiet"]) == 0
    reconstruction = pycolmap.Reconstruction(str(tmp_path / "m"))
    assert reconstruction.cameras[1].model.name == "OPENCV"
    assert reconstruction.cameras[2].model.name == "FULL_OPENCV"
    ray = np.array([0.3, 0.2, 1.0])
    assert np.allclose(reconstruction.cameras[2].img_from_cam(ray), lens.project(ray) + 0.5, atol=1e-9)


@pytest.mark.parametrize("most", [1, 700, 10**9])
def test_the_number_of_points_is_as_requested(
    written: Written, tmp_path: Path, capsys: pytest.CaptureFixture[str], most: int
) -> None:
    out = tmp_path / "model"
    assert main(["export", str(written.folder), "--to", "colmap", "--points", str(most), "--out", str(out)]) == 0
    lines = [line for line in (out / "points3D.txt").read_text().splitlines() if not line.startswith("#")]
    assert min(most, len(written.scan)) / 2 <= len(lines) <= most
    assert f"{len(lines):,} of {len(written.scan):,} points" in capsys.readouterr().out
