"""Calibrations in files of OpenCV, as several programs write them, are those of this program."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from scanner.errors import InputError
from scanner.exporting import FORMATS, ExportRequest
from scanner.io.calibration_file import read_calibration, write_calibration
from scanner.results import read_uncertainty
from tests.scanner.io.test_calibration_file import CALIBRATION, same

DIALECTS = {
    "stereoCalibrate": ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
    "OpenCV's example": ("M1", "D1", "M2", "D2", "R", "T"),
    "Moreno and Taubin": ("cam_K", "cam_kc", "proj_K", "proj_kc", "R", "T"),
    "SLStudio": ("Kc", "kc", "Kp", "kp", "Rp", "Tp"),
}
SIZES = {
    "SLStudio": ("frameWidth", "frameHeight", "screenResX", "screenResY"),
    "other": ("camera_width", "camera_height", "projector_width", "projector_height"),
}


def written(path: Path, dialect: str, **changed: Any) -> Path:
    """The calibration as OpenCV's FileStorage writes it, YAML or XML by the ending; None leaves a key out."""
    camera, projector, pose = CALIBRATION.camera, CALIBRATION.projector, CALIBRATION.pose
    values = (
        camera.matrix,
        np.array([camera.distortion]),
        projector.matrix,
        np.array([projector.distortion]).T,
        pose.rotation,
        pose.translation[:, None],
    )
    sizes = (*camera.size, *projector.size)
    entries: dict[str, Any] = dict(zip(DIALECTS[dialect], values, strict=True))
    entries |= {"stereo_error": 0.31, **dict(zip(SIZES.get(dialect, SIZES["other"]), map(int, sizes), strict=True))}
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in (entries | changed).items():
        if value is not None:
            storage.write(name, np.ascontiguousarray(value) if isinstance(value, np.ndarray) else value)
    storage.release()
    return path


@pytest.mark.parametrize("ending", ["yml", "yaml", "xml"])
@pytest.mark.parametrize("dialect", DIALECTS)
def test_each_program_is_read(dialect: str, ending: str, tmp_path: Path) -> None:
    found = read_calibration(written(tmp_path / f"stereo.{ending}", dialect))
    assert found.unit == "baseline"
    for ours, theirs in ((found.camera, CALIBRATION.camera), (found.projector, CALIBRATION.projector)):
        assert ours.size == theirs.size
        np.testing.assert_allclose(ours.focal_px, theirs.focal_px, rtol=1e-12)
        np.testing.assert_allclose(ours.distortion, theirs.distortion, atol=1e-15)
    np.testing.assert_allclose(found.pose.rotation, CALIBRATION.pose.rotation, atol=1e-12)
    np.testing.assert_allclose(found.pose.translation, CALIBRATION.in_baselines.pose.translation, atol=1e-12)


def test_what_is_exported_is_read_back_with_its_unit(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.yaml", CALIBRATION)
    FORMATS["opencv"].write(ExportRequest(tmp_path, tmp_path / "opencv.yaml"))
    found = read_calibration(tmp_path / "opencv.yaml")
    assert found.unit == "m"
    np.testing.assert_allclose(found.pose.translation, CALIBRATION.pose.translation, rtol=1e-12)
    assert found.camera == CALIBRATION.camera
    assert read_uncertainty(tmp_path / "opencv.yaml", found) is None
    assert same(read_calibration(tmp_path / "calibration.yaml"), CALIBRATION)


SKEWED = CALIBRATION.camera.matrix @ np.array([[1.0, 0.002, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"camera_width": None}, "says no size: add the line camera_width, as in camera_width: 1280"),
        ({"M2": None}, "is a file of OpenCV without projector_matrix (or cameraMatrix2, M2"),
        ({"M1": SKEWED}, "M1 has a skew of 3.5822"),
        ({"D1": np.full((1, 8), 0.1)}, "D1 has 8 terms: expected k1, k2, p1, p2, k3"),
        ({"R": np.eye(4)}, "R must have 3 × 3 numbers, found 16"),
        ({"R": 2 * np.eye(3)}, "rotation"),
        ({"T": np.full((3, 1), np.nan)}, "T must be a matrix of numbers"),
        ({"T": np.zeros((3, 1))}, "translation must not be zero"),
        ({"T": "far"}, "T must be a matrix of numbers"),
        ({"projector_height": "tall"}, "projector_height must be a whole number of pixels"),
    ],
)
@pytest.mark.parametrize("ending", ["yml", "xml"])
def test_what_is_wrong_is_said(changed: dict[str, Any], words: str, ending: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"stereo.{ending}", "OpenCV's example", **changed)
    with pytest.raises(InputError) as refused:
        read_calibration(path)
    assert words in str(refused.value)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<opencv_storage><a>", "not valid XML"),
        (
            "<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b 'c'>]><opencv_storage>&b;</opencv_storage>",
            "expected 'key: value' lines",
        ),
        ("%YAML:1.0\n---\n- 1\n", "expected 'key: value' lines"),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix [\n", "YAML"),
    ],
)
def test_damaged_files_are_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "stereo.yml").write_text(text)
    with pytest.raises(InputError) as refused:
        read_calibration(tmp_path / "stereo.yml")
    assert words in str(refused.value)
