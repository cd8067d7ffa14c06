"""A result that was read back knows the match of each point; in older results it is searched for."""

from pathlib import Path

import numpy as np
import pytest

from calib.geometry import intersect
from scanner.errors import InputError
from scanner.io import read_cloud, write_ply
from scanner.results.finished_result import read_finished_scan
from tests.support.cloud_scene import room
from tests.support.result_folder import Written, write_result


def sparse_at_the_left(camera_px: np.ndarray) -> np.ndarray:
    """Points without neighbours are dropped, so that points and matches have different numbers."""
    x, y = camera_px.T
    return np.asarray((x > 150) | ((x % 9 == 0) & (y % 9 == 0)))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    return write_result(tmp_path_factory.mktemp("finished") / "room", keep=sparse_at_the_left)


def test_points_are_where_the_rays_of_their_matches_meet(written: Written) -> None:
    met = intersect(written.scan.matches, written.scan.calibration)
    apart = np.linalg.norm(met.points - written.scan.points, axis=1) / np.linalg.norm(met.points, axis=1)
    assert 0 < apart.max() < 1e-6  # of the file's 24 bits
    assert len(written.scan) < written.scan.matched


def test_an_older_result_opens_with_the_same_matches(written: Written, tmp_path: Path) -> None:
    older = write_result(tmp_path / "room", keep=sparse_at_the_left, numbered=False)
    assert read_cloud(older.folder / "cloud.ply").match is None
    assert np.array_equal(older.scan.matches.projector_px, written.scan.matches.projector_px)
    assert np.array_equal(older.scan.pixel, written.scan.pixel)


@pytest.mark.parametrize("numbers", ["others", "too large", "negative", "twice the same"])
def test_wrong_match_numbers_are_refused(tmp_path: Path, numbers: str) -> None:
    written = write_result(tmp_path / "room")
    match = np.array(read_cloud(written.folder / "cloud.ply").match)
    match[:] = {
        "others": match[::-1],
        "too large": match + len(room().matches),
        "negative": match - len(room().matches),
        "twice the same": match[0],
    }[numbers]
    write_ply(written.folder / "cloud.ply", _AsCloud(written), match=match)
    with pytest.raises(InputError, match="does not follow from"):
        read_finished_scan(written.folder)


class _AsCloud:
    """The points of a finished scan, as written to a file."""

    def __init__(self, written: Written) -> None:
        self.points, self.normals, self.colours = written.scan.points, written.scan.normals, written.scan.colours
        self.unit = written.scan.unit
