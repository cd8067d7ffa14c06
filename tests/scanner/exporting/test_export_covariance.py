"""`scan export` of the covariance, and to mrcal, read as the formats are documented."""

import ast
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.diagnostics import Uncertainty
from calib.geometry import Intrinsics
from calib.numerics import Floats
from calib.refinement import PROJECTOR, SHARED, State, device_of
from scanner.commands import main
from scanner.io import write_calibration
from scanner.results import Verdict, confidence_entries
from tests.support.cloud_scene import PROJECTOR as PLAIN_PROJECTOR
from tests.support.result_folder import Written, write_result

_OF_BASELINE = 0.002  # relative sigma
_PROJECTOR = Intrinsics(
    854, 480, PLAIN_PROJECTOR.focal_px, PLAIN_PROJECTOR.principal_point_px, (0.02, -0.01, 1e-3, -2e-3, 0.03)
)


def covariance() -> Floats:
    """Of a rig's columns and the logarithm of the baseline: correlated, one column held, (22, 22)."""
    sigma = np.array([1e-3, 2, 3, 1e-3, 2e-3, 1e-4, 1e-4, 1e-3] * 2 + [1e-3] * 3 + [2e-3] * 2 + [_OF_BASELINE])
    root = np.random.default_rng(4).normal(size=(SHARED + 1, 2 * SHARED))
    joint = root @ root.T
    scale = np.sqrt(np.diag(joint))
    joint *= np.outer(sigma / scale, sigma / scale)
    joint[PROJECTOR.start + 1], joint[:, PROJECTOR.start + 1] = 0.0, 0.0
    return joint


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    made = write_result(tmp_path_factory.mktemp("covariance") / "room", projector=_PROJECTOR)
    calibration, joint = made.scan.calibration, covariance()
    known = replace(calibration, sigma=replace(calibration.sigma, known_baseline=_OF_BASELINE * calibration.baseline))
    stated = Uncertainty(state_of(made), joint[:SHARED, :SHARED], None, 0.05, with_log_baseline=joint[:SHARED, SHARED])
    more = confidence_entries(Verdict("good", "Well", ("so",)), stated)
    write_calibration(made.folder / "calibration.yaml", known, more)
    return made


def state_of(made: Written) -> State:
    calibration = made.scan.calibration
    return State(device_of(calibration.camera), device_of(calibration.projector), calibration.pose.in_baselines)


def exported(written: Written, to: str, out: Path) -> Path:
    assert main(["export", str(written.folder), "--to", to, "--out", str(out), "--quiet"]) == 0
    return out


def parameters(made: Written, step: Floats) -> Floats:
    """The exported parameters (24,) after a step (22,) of the columns and the logarithm of the baseline."""
    begun, calibration = state_of(made), made.scan.calibration
    moved = begun.moved(step[:SHARED])
    turn = Rotation.from_matrix(moved.pose.rotation @ begun.pose.rotation.T).as_rotvec()
    length = calibration.baseline * np.exp(step[SHARED])
    lenses = [
        np.array([moved_device[0], moved_device[0] * device.focal_px[1] / device.focal_px[0], *moved_device[1:]])
        for moved_device, device in (
            (moved.camera, calibration.camera),
            (moved.projector, calibration.projector),
        )
    ]
    return np.concatenate([*lenses, turn, length * moved.pose.translation])


def read_text(path: Path) -> tuple[list[str], Floats]:
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return [row[0] for row in rows], np.array([row[1:] for row in rows], np.float64)


def test_the_covariance_is_that_of_drawn_calibrations(written: Written, tmp_path: Path) -> None:
    names, stated = read_text(exported(written, "mrcal", tmp_path / "m") / "covariance.txt")
    assert names[:4] == ["camera_fx", "camera_fy", "camera_cx", "camera_cy"]
    assert names[-6:] == [*(f"rotation_{axis}" for axis in "xyz"), *(f"translation_{axis}" for axis in "xyz")]
    root = np.linalg.cholesky(covariance() + 1e-16 * np.eye(SHARED + 1))
    steps = np.random.default_rng(0).normal(size=(20_000, SHARED + 1)) @ root.T
    drawn = np.array([parameters(written, step) for step in steps])
    sigma = np.sqrt(np.diag(stated))
    held = names.index("projector_cx")
    assert not stated[held].any()
    free = np.arange(len(names)) != held
    ratio = drawn.std(axis=0)[free] / sigma[free]
    assert ratio.min() > 0.97
    assert ratio.max() < 1.03
    correlation = (stated / np.outer(np.where(free, sigma, 1), np.where(free, sigma, 1)))[np.ix_(free, free)]
    off = np.abs(np.corrcoef(drawn[:, free].T) - correlation)
    assert 1e-4 < off.max() < 0.05
    assert np.abs(correlation[-6:, :9]).max() > 0.1  # the test would see exchanged columns


def test_opencv_and_colmap_carry_the_same(written: Written, tmp_path: Path) -> None:
    names, stated = read_text(exported(written, "mrcal", tmp_path / "m") / "covariance.txt")
    storage = cv2.FileStorage(str(exported(written, "opencv", tmp_path / "o.yaml")), cv2.FILE_STORAGE_READ)
    node = storage.getNode("covariance_parameters")
    assert [node.at(i).string() for i in range(node.size())] == names
    np.testing.assert_array_equal(storage.getNode("covariance").mat(), stated)
    of_colmap = exported(written, "colmap", tmp_path / "c")
    assert (of_colmap / "covariance.txt").read_text() == (tmp_path / "m" / "covariance.txt").read_text()
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    assert pycolmap.Reconstruction(str(of_colmap)).num_images() == 2


def test_a_result_without_covariance_is_exported_without(tmp_path: Path) -> None:
    plain = write_result(tmp_path / "room")
    assert {path.name for path in exported(plain, "mrcal", tmp_path / "m").iterdir()} == {
        "camera.cameramodel",
        "projector.cameramodel",
    }
    assert not (exported(plain, "colmap", tmp_path / "c") / "covariance.txt").exists()
    storage = cv2.FileStorage(str(exported(plain, "opencv", tmp_path / "o.yaml")), cv2.FILE_STORAGE_READ)
    assert not storage.getNode("R").empty()
    assert storage.getNode("covariance").empty()


def test_nothing_is_overwritten_unasked(written: Written, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = exported(written, "mrcal", tmp_path / "m")
    (out / "camera.cameramodel").unlink()
    (out / "projector.cameramodel").unlink()
    again = ["export", str(written.folder), "--to", "mrcal", "--out", str(out), "--quiet"]
    assert main(again) == 2
    assert "covariance.txt" in capsys.readouterr().err
    assert main([*again, "--overwrite"]) == 0


class CameraModel:
    """What mrcal reads: a literal dictionary; LENSMODEL_OPENCV5 is f_x, f_y, c_x, c_y and OpenCV's k1 k2 p1 p2 k3, and
    the extrinsics lead from the reference frame to the camera's.
    """

    def __init__(self, path: Path) -> None:
        model: dict[str, Any] = ast.literal_eval(path.read_text(encoding="utf-8"))
        assert set(model) == {"lens_model", "intrinsics", "extrinsics", "imagersize"}
        assert model["lens_model"] == "LENSMODEL_OPENCV5"
        assert len(model["intrinsics"]) == 9
        assert len(model["extrinsics"]) == 6
        self.size = tuple(model["imagersize"])
        fx, fy, cx, cy, *self.lens = model["intrinsics"]
        self.matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        self.pose = np.array(model["extrinsics"], np.float64)

    def project(self, points: Floats) -> Floats:
        pixels, _ = cv2.projectPoints(
            points[:, None].copy(), self.pose[:3], self.pose[3:], self.matrix, np.array(self.lens)
        )
        return np.asarray(pixels[:, 0], np.float64)


def test_models_of_mrcal_project_the_cloud_to_its_pixels(written: Written, tmp_path: Path) -> None:
    out, scan = exported(written, "mrcal", tmp_path / "m"), written.scan
    camera, projector = (CameraModel(out / f"{name}.cameramodel") for name in ("camera", "projector"))
    assert camera.size == scan.calibration.camera.size
    assert projector.size == scan.calibration.projector.size
    assert not camera.pose.any()
    points = scan.points[::50]
    ours = scan.calibration.projector.project(scan.calibration.pose @ points)
    np.testing.assert_allclose(projector.project(points), ours, atol=1e-6)
    for model, pixels in ((camera, scan.matches.camera_px), (projector, scan.matches.projector_px)):
        off = np.linalg.norm(model.project(points) - pixels[::50], axis=1)
        assert 1e-3 < np.median(off) < 0.2


@pytest.mark.parametrize("to", ["mrcal", "colmap"])
def test_another_calibrations_covariance_does_not_stay(written: Written, tmp_path: Path, to: str) -> None:
    out = exported(written, to, tmp_path / "out")
    assert (out / "covariance.txt").exists()
    plain = write_result(tmp_path / "room")
    assert main(["export", str(plain.folder), "--to", to, "--out", str(out), "--quiet", "--overwrite"]) == 0
    assert not (out / "covariance.txt").exists()
