from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Pose
from scanner.errors import InputError
from scanner.io.room_file import read_poses, write_poses


def poses() -> list[Pose]:
    rng = np.random.default_rng(3)
    return [Pose(turned, rng.normal(size=3)) for turned in Rotation.random(3, random_state=3).as_matrix()]


def test_poses_read_back_the_same(tmp_path: Path) -> None:
    write_poses(tmp_path / "poses.yaml", poses())
    for pose, written in zip(read_poses(tmp_path / "poses.yaml", 3), poses(), strict=True):
        assert np.array_equal(pose.rotation, written.rotation)
        assert np.array_equal(pose.translation, written.translation)


@pytest.mark.parametrize(
    ("old", "new", "count", "words"),
    [
        ("", "", 2, "2 captures, found 3"),
        ("position", "place", 3, "position"),
        ("rotation: [[", "rotation: [[1", 3, "rotation"),
        ("cameras", "camera", 3, "cameras"),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, old: str, new: str, count: int, words: str) -> None:
    path = tmp_path / "poses.yaml"
    write_poses(path, poses())
    path.write_text(path.read_text().replace(old, new, 1) if old else path.read_text())
    with pytest.raises(InputError, match=words):
        read_poses(path, count)
