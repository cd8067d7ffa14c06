"""The verdict and the covariance, written to a calibration file and read back.

Errors of poses, from a joint covariance, and written to a file and read back.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.diagnostics import PoseErrors, Uncertainty
from calib.geometry import IDENTITY, PER_POSE, Calibration, Pose, intersect, rotation_about
from calib.numerics import Floats
from calib.refinement import CAMERA, ROTATION, SHARED, TRANSLATION, State
from scanner.errors import InputError
from scanner.io import read_calibration, write_calibration, write_poses
from scanner.results import pose_error_entries, read_pose_errors, read_verdict
from scanner.results.stated_uncertainty import COLUMNS, confidence_entries, read_uncertainty
from scanner.results.verdict import Verdict
from tests.support.cloud_scene import Scene, room

VERDICT = Verdict("fair", "Calibrated, well enough for a first look", ("± 3 %: “known”", "# no: comment"), "Once more.")
DIRECTION = np.array([0.9, 0.1, -0.3])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return room(noise_px=0.0)


def uncertainty_of(calibration: Calibration, covariance: Floats) -> Uncertainty:
    camera, projector = (
        np.array([device.focal_px[0], *device.principal_point_px, *device.distortion])
        for device in (calibration.camera, calibration.projector)
    )
    translation = calibration.pose.translation / calibration.baseline
    state = State(camera, projector, Pose(calibration.pose.rotation, translation), np.zeros((1, 3)), ())
    return Uncertainty(state, covariance, None, 0.04)


def drawn_covariance() -> Floats:
    root = np.random.default_rng(3).normal(size=(SHARED, SHARED)) * 1e-3
    covariance: Floats = root @ root.T
    return covariance


def test_verdict_and_covariance_read_back_the_same(scene: Scene, tmp_path: Path) -> None:
    path, calibration = tmp_path / "calibration.yaml", scene.calibration
    given = uncertainty_of(calibration, drawn_covariance())
    write_calibration(path, calibration, confidence_entries(VERDICT, given))
    assert read_calibration(path).camera == calibration.camera
    assert read_verdict(path) == VERDICT
    found = read_uncertainty(path, read_calibration(path))
    assert found is not None
    assert found.covariance == pytest.approx(given.covariance, rel=1e-9, abs=1e-15)
    sample = scene.matches[::97]
    assert found.of_points(sample) == pytest.approx(given.of_points(sample), rel=1e-6)


def test_covariance_columns_match_the_format(scene: Scene, tmp_path: Path) -> None:
    """A step of one column of the file, made as docs/formats.md describes, equals the model's."""
    calibration = scene.calibration
    direction = calibration.pose.translation / calibration.baseline
    for column, name in ((CAMERA.start, "camera_log_focal"), (ROTATION.start + 2, "rotation_z_rad")):
        covariance = np.zeros((SHARED, SHARED))
        covariance[column, column] = 4.0
        written = confidence_entries(VERDICT, uncertainty_of(calibration, covariance))["covariance"]
        values = np.array(written["values"])
        assert values[COLUMNS.index(name), COLUMNS.index(name)] == 4.0
        assert np.count_nonzero(values) == 1
    step = np.zeros(6)
    step[3:5] = 1e-4, -2e-4
    covariance = np.zeros((SHARED, SHARED))
    covariance[TRANSLATION, TRANSLATION] = np.outer(step[3:5], step[3:5])
    values = np.array(confidence_entries(VERDICT, uncertainty_of(calibration, covariance))["covariance"]["values"])
    moved = Pose(calibration.pose.rotation, direction).retract_baseline(step).translation - direction
    assert values[-3:, -3:] == pytest.approx(np.outer(moved, moved), rel=1e-3, abs=1e-11)
    assert np.abs(values[-3:, -3:] @ direction).max() < 1e-15


def test_files_of_two_radial_terms_are_read(scene: Scene, tmp_path: Path) -> None:
    calibration, path = scene.calibration, tmp_path / "calibration.yaml"
    sigma = np.zeros(SHARED)
    sigma[[CAMERA.start, CAMERA.start + 4, ROTATION.start]] = 1e-3, 2e-2, 1e-4
    given = np.outer(sigma, sigma)
    written = confidence_entries(VERDICT, uncertainty_of(calibration, given))
    kept = [i for i, column in enumerate(COLUMNS) if not column.endswith(("p1", "p2", "k3"))]
    entry = written["covariance"]
    entry["columns"] = [COLUMNS[i] for i in kept]
    entry["values"] = np.array(entry["values"])[np.ix_(kept, kept)].tolist()
    write_calibration(path, calibration, written)
    found = read_uncertainty(path, calibration)
    assert found is not None
    assert found.covariance == pytest.approx(given, rel=1e-9, abs=1e-15)
    entry["values"].pop()
    write_calibration(path, calibration, written)
    with pytest.raises(InputError, match="columns"):
        read_uncertainty(path, calibration)


def test_point_sigmas_match_calibrations_drawn_from_the_covariance(scene: Scene, tmp_path: Path) -> None:
    """By the format alone: draw focal lengths, rotations and directions, and triangulate with each."""
    calibration, sample = scene.calibration, scene.matches[::211]
    covariance = np.diag([1e-6, *[0] * 7, 4e-6, *[0] * 7, 1e-8, 4e-8, 1e-8, 1e-7, 2e-7])
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration, confidence_entries(VERDICT, uncertainty_of(calibration, covariance)))
    entry = yaml.safe_load(path.read_text(encoding="utf-8"))["covariance"]
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(len(COLUMNS)), entry["values"], 400, method="eigh")
    depths = [intersect(sample, _moved(calibration, dict(zip(entry["columns"], draw, strict=True)))) for draw in draws]
    found = read_uncertainty(path, calibration)
    assert found is not None
    exact = replace(sample, sigma_px=np.full(len(sample), 1e-9))
    predicted = calibration.baseline * found.of_points(exact)[:, 2]
    ratio = np.std([met.points[:, 2] for met in depths], axis=0) / predicted
    assert 0.8 < ratio.min() < ratio.max() < 1.2


def _moved(calibration: Calibration, step: dict[str, float]) -> Calibration:
    camera, projector = (
        replace(device, focal_px=(device.focal_px[0] * np.exp(step[f"{name}_log_focal"]),) * 2)
        for name, device in (("camera", calibration.camera), ("projector", calibration.projector))
    )
    turned = np.array([step[f"rotation_{axis}_rad"] for axis in "xyz"])
    direction = calibration.pose.translation / calibration.baseline
    direction = direction + np.array([step[f"translation_{axis}"] for axis in "xyz"])
    rotation = rotation_about(turned) @ calibration.pose.rotation
    pose = Pose(rotation, calibration.baseline * direction / np.linalg.norm(direction))
    return replace(calibration, camera=camera, projector=projector, pose=pose)


def test_an_older_result_has_neither(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    write_calibration(path, scene.calibration)
    assert read_verdict(path) is None
    assert read_uncertainty(path, scene.calibration) is None


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("covariance: {columns: [a], match_px: 0.1, values: [[1.0]]}", "columns"),
        (f"covariance: {{columns: [{', '.join(COLUMNS)}], match_px: 0.1, values: [[1.0]]}}", "22 rows"),
        (f"covariance: {{columns: [{', '.join(COLUMNS)}], match_px: 0.1, values: [[.nan]]}}", "values"),
    ],
)
def test_malformed_files_are_refused(scene: Scene, tmp_path: Path, entry: str, message: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(entry, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_uncertainty(path, scene.calibration)


@pytest.mark.parametrize("name", ["asymmetric", "negative", "indefinite", "beyond any device"])
def test_an_invalid_covariance_is_refused(scene: Scene, tmp_path: Path, name: str) -> None:
    count = len(COLUMNS)
    values = 1e-6 * np.eye(count)
    match name:
        case "asymmetric":
            values[0, 1] = 5e-7
        case "negative":
            values[2, 2] = -1e-6
        case "indefinite":
            values[0, 1] = values[1, 0] = 2e-6
        case _:
            values[0, 0] = 1e4
    path = tmp_path / "calibration.yaml"
    given = {"columns": [*COLUMNS], "match_px": 0.1, "values": values.tolist()}
    write_calibration(path, scene.calibration, {"covariance": given})
    with pytest.raises(InputError, match="are no covariance"):
        read_uncertainty(path, scene.calibration)


@pytest.fixture
def errors() -> PoseErrors:
    root = np.random.default_rng(0).normal(size=(SHARED + 2 * PER_POSE,) * 2)
    return PoseErrors.from_joint(root @ root.T, [np.eye(PER_POSE), 2 * np.eye(PER_POSE)])


def test_poses_vary_as_their_joint_covariance_says() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(SHARED + PER_POSE,) * 2)
    drawn = rng.normal(size=(100_000, SHARED + PER_POSE)) @ root.T
    errors = PoseErrors.from_joint(root @ root.T, [np.eye(PER_POSE)])
    rest = drawn[:, SHARED:] - drawn[:, :SHARED] @ errors.by_calibration.T
    assert np.allclose(np.cov(rest.T), errors.covariance, atol=0.03 * np.abs(errors.covariance).max())
    # What remains does not depend on the calibration.
    across = np.corrcoef(rest.T, drawn[:, :SHARED].T)[:PER_POSE, PER_POSE:]
    assert 0 < np.abs(across).max() < 0.02


def test_they_read_back(errors: PoseErrors, tmp_path: Path) -> None:
    write_poses(tmp_path / "poses.yaml", [IDENTITY] * 2, pose_error_entries(errors, DIRECTION))
    read = read_pose_errors(tmp_path / "poses.yaml", 2, DIRECTION)
    assert read is not None
    assert np.allclose(read.covariance, errors.covariance)
    assert np.allclose(read.by_calibration, errors.by_calibration)
    write_poses(tmp_path / "poses.yaml", [IDENTITY] * 2)
    assert read_pose_errors(tmp_path / "poses.yaml", 2, DIRECTION) is None


def test_undetermined_poses_have_no_entry(errors: PoseErrors) -> None:
    undetermined = PoseErrors(np.full_like(errors.covariance, np.nan), errors.by_calibration)
    assert pose_error_entries(undetermined, DIRECTION) == {}


@pytest.mark.parametrize(
    ("key", "change", "words"),
    [
        ("pose_covariance", lambda rows: rows[:5], "12 rows of 12 numbers"),
        ("pose_covariance", lambda rows: [row[:5] for row in rows], "12 rows of 12 numbers"),
        ("pose_by_calibration", lambda rows: rows[:1], "12 rows of 22 numbers"),
        ("pose_covariance", lambda rows: (-np.array(rows)).tolist(), "is no covariance"),
        ("pose_covariance", lambda rows: np.triu(rows).tolist(), "is no covariance"),
    ],
)
def test_malformed_entries(errors: PoseErrors, tmp_path: Path, key: str, change: object, words: str) -> None:
    assert callable(change)
    entries = pose_error_entries(errors, DIRECTION)
    entries[key] = change(entries[key])
    write_poses(tmp_path / "poses.yaml", [IDENTITY] * 2, entries)
    with pytest.raises(InputError, match=words):
        read_pose_errors(tmp_path / "poses.yaml", 2, DIRECTION)
