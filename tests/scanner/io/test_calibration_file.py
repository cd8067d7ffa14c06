"""Calibrations in files of OpenCV, as several programs write them, are those of this program."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, DeviceSigmas, Intrinsics, Pose, Sigmas
from scanner.errors import InputError
from scanner.exporting import FORMATS, ExportRequest
from scanner.io.calibration_file import read_calibration, write_calibration
from scanner.results import read_uncertainty

CALIBRATION = Calibration(
    Intrinsics(2448, 2048, (1791.1, 1791.2), (1256.3, 1054.3), (-0.06, 0.01, 1e-5, -2e-17, 0.0)),
    Intrinsics(854, 480, (1247.3, 1247.3), (377.1, 234.0)),
    Pose(Rotation.from_rotvec([0.1, -0.2, 1 / 3]).as_matrix(), np.array([-0.4, 0.05, 1 / 7])),
    "m",
    Sigmas(DeviceSigmas((1.5, 1.5)), DeviceSigmas(principal_point_px=(0.1, 0.2))),
)

positive = st.floats(0.1, 1e5)
number = st.floats(-1e5, 1e5)
term = st.floats(-1e4, 1e4)
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


@st.composite
def calibrations(draw: st.DrawFn) -> Calibration:
    def device() -> Intrinsics:
        return Intrinsics(
            draw(st.integers(1, 10_000)),
            draw(st.integers(1, 10_000)),
            (draw(positive), draw(positive)),
            (draw(number), draw(number)),
            draw(st.tuples(term, term, term, term, term)),
        )

    rotation = Rotation.from_rotvec([draw(st.floats(-2, 2)) for _ in range(3)]).as_matrix()
    translation = np.array([draw(number), draw(number), draw(positive)])
    unit = draw(st.sampled_from(["baseline", "m", "mm", "y", "1", "no", "#", "null", ": "]))
    pairs, triples = (st.none() | st.tuples(*[positive] * count) for count in (2, 3))

    def sigmas() -> DeviceSigmas:
        terms = draw(st.none() | st.lists(positive, min_size=1, max_size=5))
        return DeviceSigmas(draw(pairs), draw(pairs), None if terms is None else tuple(terms))

    single = st.none() | positive
    sigma = Sigmas(sigmas(), sigmas(), draw(triples), draw(single), draw(triples), draw(single), draw(single))
    return Calibration(device(), device(), Pose(rotation, translation), unit, sigma)


def same(a: Calibration, b: Calibration) -> bool:
    return (
        (a.camera, a.projector, a.unit, a.sigma) == (b.camera, b.projector, b.unit, b.sigma)
        and np.array_equal(a.pose.rotation, b.pose.rotation)
        and np.array_equal(a.pose.translation, b.pose.translation)
    )


@given(calibrations())
def test_every_number_reads_back_the_same(tmp_path_factory: pytest.TempPathFactory, calibration: Calibration) -> None:
    path = tmp_path_factory.getbasetemp() / "calibration.yaml"
    write_calibration(path, calibration)
    assert same(read_calibration(path), calibration)


def test_the_keys_of_the_file_format_are_fixed(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.yaml", CALIBRATION)
    data = yaml.safe_load((tmp_path / "calibration.yaml").read_text())
    assert list(data) == ["camera", "projector", "rotation", "translation", "unit", "sigma"]
    assert list(data["camera"]) == ["width", "height", "focal_px", "principal_point_px", "distortion"]
    assert data["camera"]["focal_px"] == [1791.1, 1791.2]
    assert data["sigma"] == {"camera_focal_px": 1.5, "projector_principal_point_px": [0.1, 0.2]}
    np.testing.assert_array_equal(data["rotation"], CALIBRATION.pose.rotation)


def written(tmp_path: Path, **changes: object) -> Path:
    path = tmp_path / "calibration.yaml"
    write_calibration(path, CALIBRATION)
    data = yaml.safe_load(path.read_text())
    for key, value in changes.items():
        section, _, name = key.partition("__")
        place, last = (data[section], name) if name else (data, section)
        if value is None:
            del place[last]
        else:
            place[last] = value
    path.write_text(yaml.safe_dump(data))
    return path


def test_a_short_distortion_is_padded_with_zeros(tmp_path: Path) -> None:
    assert read_calibration(written(tmp_path, camera__distortion=[-0.1, 0.2])).camera.distortion == (-0.1, 0.2, 0, 0, 0)
    assert read_calibration(written(tmp_path, camera__distortion=[])).camera.distortion == (0,) * 5
    assert read_calibration(written(tmp_path, camera__distortion=None)).camera.distortion == (0,) * 5


def test_keys_of_other_readers_are_ignored(tmp_path: Path) -> None:
    assert same(read_calibration(written(tmp_path, date="2026-01-01", camera__serial=7)), CALIBRATION)


def test_sigma_may_be_left_out(tmp_path: Path) -> None:
    assert read_calibration(written(tmp_path, sigma=None)).sigma == Sigmas()


def test_sigmas_of_other_programs_are_read(tmp_path: Path) -> None:
    sigma = {"camera_focal_px": [1, 2.5], "camera_principal_point_px": 3, "corner_angles_deg": 0.1, "skew": 1.0}
    found = read_calibration(written(tmp_path, sigma=sigma)).sigma
    assert found == Sigmas(DeviceSigmas((1.0, 2.5), (3.0, 3.0)), corner_angles_deg=(0.1, 0.1, 0.1))


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no camera": ({"camera": None}, "'camera' is missing"),
    "no unit": ({"unit": None}, "'unit' is missing"),
    "no focal": ({"projector__focal_px": None}, "'projector.focal_px' is missing"),
    "one focal": ({"camera__focal_px": [1000]}, r"'camera.focal_px\[1\]' is missing"),
    "negative focal": (
        {"camera__focal_px": [1000, -1000]},
        r"'camera.focal_px\[1\]' must be greater than or equal to 0.1, found -1000",
    ),
    "endless focal": ({"camera__focal_px": [1000, float("inf")]}, r"'camera.focal_px\[1\]' must be a finite number"),
    "word as focal": ({"camera__focal_px": ["f", 1]}, r"'camera.focal_px\[0\]' must be a valid number, found 'f'"),
    "six distortions": ({"camera__distortion": [0.0] * 6}, "'camera.distortion' must have at most 5 items"),
    "two rows": ({"rotation": [[1, 0, 0], [0, 1, 0]]}, r"'rotation\[2\]' is missing"),
    "no rotation": ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "rotation must be orthonormal"),
    "mirror": ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "determinant"),
    "no baseline": ({"translation": [0, 0, 0]}, "translation must not be zero"),
    "no size": ({"camera__width": 0}, "'camera.width' must be greater than or equal to 1"),
    "three focal sigmas": ({"sigma": {"camera_focal_px": [1, 1, 1]}}, "sigma.camera_focal_px"),
    "negative sigma": ({"sigma": {"camera_focal_px": -1}}, "sigma.camera_focal_px"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_calibration_is_refused(tmp_path: Path, name: str) -> None:
    changes, message = WRONG[name]
    with pytest.raises(InputError, match=f"calibration.yaml: .*{message}"):
        read_calibration(written(tmp_path, **changes))


def test_a_missing_calibration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_calibration(tmp_path / "calibration.yaml")


def written_by_opencv(path: Path, dialect: str, **changed: Any) -> Path:
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
    found = read_calibration(written_by_opencv(tmp_path / f"stereo.{ending}", dialect))
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
    path = written_by_opencv(tmp_path / f"stereo.{ending}", "OpenCV's example", **changed)
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
