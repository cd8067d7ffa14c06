"""`scan replay` of captures by others with real hardware."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from scanner.commands import main
from scanner.io import read_cloud
from tests.support.places import REAL_CAPTURES

DATA = REAL_CAPTURES

pytestmark = [
    pytest.mark.skipif(not DATA.is_dir(), reason=f"the real captures are not there: {DATA}"),
    pytest.mark.xdist_group("real-captures"),
]

Layout = list[tuple[str, str] | tuple[str, str, int]]


def test_a_calibrated_rig_gives_a_cloud_on_the_reference(tmp_path: Path) -> None:
    capture, out = DATA / "sltk-scan0020", tmp_path / "shell"
    arguments = ["replay", str(capture), "--calibration", str(capture / "calibration.yaml"), "--out", str(out)]
    assert main([*arguments, "--quiet"]) == 0
    points = read_cloud(out / "cloud.ply").points
    reference = _reference_points(capture / "reference.ply") * [1, -1, -1]
    assert 100_000 < len(points) < 110_000
    distance = cKDTree(reference).query(points)[0]
    # An independent decoder came to 0.012 and 0.38, in millimetres.
    assert 0.001 < np.median(distance) < 0.02
    assert 0.1 < np.percentile(distance, 95) < 0.45


@pytest.mark.parametrize("name", ["phase-shifting-object1", "phase-shifting-object2"])
def test_a_scene_without_a_corner_is_refused_and_its_matches_kept(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / name
    assert main(["replay", str(DATA / name), "--out", str(out), "--quiet"]) == 4
    assert "perpendicular" in capsys.readouterr().err
    assert {path.name for path in out.iterdir()} == {
        "capture",
        "matches.npz",
        "refused.yaml",
        "report.html",
        "scan.log",
    }
    with np.load(out / "matches.npz") as matches:
        assert 1_250_000 < len(matches["camera_px"]) < 1_600_000


def _reference_points(path: Path) -> np.ndarray:
    body = path.read_bytes().split(b"end_header\n", 1)[1]
    return np.frombuffer(body, np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)]))["xyz"].astype(np.float64)
