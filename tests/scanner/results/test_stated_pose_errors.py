"""Errors of poses, from a joint covariance, and written to a file and read back."""

from pathlib import Path

import numpy as np
import pytest

from calib.diagnostics import PoseErrors
from calib.geometry import IDENTITY, PER_POSE
from calib.refinement import SHARED
from scanner.errors import InputError
from scanner.io import write_poses
from scanner.results import pose_error_entries, read_pose_errors

DIRECTION = np.array([0.9, 0.1, -0.3])


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
