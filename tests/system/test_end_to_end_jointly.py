"""Two captures of a small simulated room, calibrated together: their files, and their accuracy."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from scanner.capture import open_capture
from scanner.io import read_calibration, read_cloud, read_matches
from scanner.quantities import intrinsic_errors_percent
from scanner.results import read_finished_scan
from tests.support.command_line import names, run
from tests.support.small_capture import with_few_rays

CONFIG = """
rig: {backend: simulated, seed: 0}
camera: {width: 408, height: 342, principal_point: {known: [209.3833, 175.7167]}}
projector: {width: 427, height: 240}
corner: {squareness_deg: 0}
scale: {baseline_m: 0.5}
"""
FILES = {"calibration.yaml", "cloud.ply", "matches.npz", "report.html", "capture"}
VERTEX = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])

pytestmark = pytest.mark.xdist_group("end to end jointly")


@dataclass(frozen=True)
class Scanned:
    config: Path
    result: Path
    exit_code: int


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Scanned:
    folder = tmp_path_factory.mktemp("scan")
    config, result = folder / "room.yaml", folder / "result"
    config.write_text(CONFIG)
    with pytest.MonkeyPatch.context() as patch:
        with_few_rays(patch)
        return Scanned(config, result, run("--config", config, "--captures", 2, "--out", result, "--quiet"))


def test_both_captures_are_kept_completely(scanned: Scanned) -> None:
    assert scanned.exit_code == 0
    assert names(scanned.result) == FILES | {"captures", "merged.ply", "poses.yaml", "scan.log", "truth.yaml"}
    assert names(scanned.result / "captures") == {"1"}
    first = scanned.result / "captures" / "1"
    assert names(first) == FILES
    poses = [open_capture(folder / "capture").metadata["devices"]["pose"] for folder in (first, scanned.result)]
    assert poses == ["0", "1"]
    assert names(scanned.result.parent) == {"room.yaml", "result"}


def test_the_calibration_is_accurate(scanned: Scanned) -> None:
    found, truth = (read_calibration(scanned.result / name) for name in ("calibration.yaml", "truth.yaml"))
    assert 1e-3 < np.abs(intrinsic_errors_percent(found, truth)).mean() < 0.3
    assert found.unit == "m"


def test_the_merged_cloud_lies_along_the_corners_edges(scanned: Scanned) -> None:
    header, body = (scanned.result / "merged.ply").read_bytes().split(b"end_header\n", 1)
    assert b"corner frame: origin at the corner's vertex" in header
    assert b"comment unit m" in header
    vertices = np.frombuffer(body, VERTEX)
    points, normals = vertices["xyz"].astype(float), vertices["normal"].astype(float)
    single = [len(read_matches(folder)) for folder in (scanned.result / "captures/1", scanned.result)]
    assert max(single) < len(points) < sum(single)
    # The room is in the octant where all coordinates are positive, and two thirds of what is lit are its faces.
    assert np.percentile(points, 1, axis=0).min() > -0.02
    assert np.all(np.percentile(points, 90, axis=0) > 0.3)
    off_face = np.min(np.abs(points), axis=1)
    assert 1e-6 < np.median(off_face) < 0.002
    for axis in range(3):
        on_face = np.abs(points[:, axis]) < 0.005
        assert on_face.mean() > 0.05
        assert 0.98 < np.median(normals[on_face, axis]) <= 1.0


def test_each_capture_can_be_exported_and_measured(scanned: Scanned) -> None:
    for folder in (scanned.result, scanned.result / "captures" / "1"):
        scan = read_finished_scan(folder)
        assert 0.95 * scan.matched < len(scan) <= scan.matched
        assert scan.unit == "m"


def test_the_report_shows_both_captures(scanned: Scanned) -> None:
    report = (scanned.result / "report.html").read_text()
    for words in ("2 clouds are merged", "the merged point cloud, oblique view", "How well depth is known"):
        assert words in report
    log = (scanned.result / "scan.log").read_text()
    assert "they agree to 0.0" in log


def test_a_replay_with_an_earlier_result_gives_the_same(scanned: Scanned, tmp_path: Path) -> None:
    config = scanned.config.parent / "with-earlier.yaml"
    config.write_text(CONFIG + "earlier: [result/captures/1]\n")
    out = tmp_path / "replayed"
    assert run("replay", scanned.result / "capture", "--config", config, "--out", out, "--quiet") == 0
    assert names(out) == FILES | {"captures", "merged.ply", "poses.yaml", "scan.log"}
    assert names(out / "captures/1") == FILES - {"capture"}
    live, replayed = (read_calibration(folder / "calibration.yaml") for folder in (scanned.result, out))
    assert np.allclose(replayed.camera.focal_px, live.camera.focal_px, rtol=1e-5)
    # The earlier capture's colours come from its recording.
    colours = [read_cloud(folder / "captures/1/cloud.ply").colours for folder in (scanned.result, out)]
    np.testing.assert_array_equal(colours[0], colours[1])
