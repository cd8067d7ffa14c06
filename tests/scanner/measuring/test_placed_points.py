"""Measuring in networks: mistakes, and files that say impossible things. Errors are tested where networks are made."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.geometry import Calibration, Intrinsics, Pose, intersect
from calib.geometry import Matches as Pairs
from calib.networks import Device, meeting_points
from scanner.commands import main
from scanner.errors import InputError
from scanner.results import read_network_errors
from tests.support.mapped_room import write_network


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_network(tmp_path_factory.mktemp("networks") / "hall", np.random.default_rng(0))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--distance", "a-b:1", "2", "a-b:3", "4"], "make it again with scan network"),
        (["--sphere", "50mm"], "are for rigs"),
    ],
)
def test_an_older_network_is_told_what_it_lacks(
    hall: Path, tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["measure", str(hall), "--out", str(tmp_path / "m"), *options]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("to", ["e57", "colmap"])
def test_a_network_has_no_cameras_pixels(
    hall: Path, tmp_path: Path, to: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(hall), "--to", to, "--out", str(tmp_path / "out.e57")]) == 2
    assert "a network has one cloud" in capsys.readouterr().err


def test_a_networks_cloud_is_cleaned_and_exported(hall: Path, tmp_path: Path) -> None:
    assert main(["clean", str(hall), "--outliers", "--quiet"]) == 0
    for to, name in (("ply", "c.ply"), ("pcd", "c.pcd"), ("stl", "c.stl"), ("mesh", "c.glb")):
        assert main(["export", str(hall), "--to", to, "--out", str(tmp_path / name), "--quiet"]) == 0
        assert (tmp_path / name).stat().st_size > 10_000
    assert main(["clean", str(hall), "--undo", "--quiet"]) == 0


@pytest.mark.parametrize(
    "entry",
    [
        {"covariance": [[1.0]]},
        {"covariance": np.diag(np.full(36, -1.0)).tolist()},
        {"covariance": np.triu(np.ones((36, 36))).tolist()},
        {"covariance": np.eye(36).tolist(), "known_distance": ["left", "nobody"]},
        {"covariance": np.eye(36).tolist(), "known_distance": ["left", "left"]},
        {"covariance": "much"},
    ],
)
def test_an_impossible_covariance_is_refused(tmp_path: Path, entry: dict[str, object]) -> None:
    path = tmp_path / "network.yaml"
    path.write_text(yaml.safe_dump(entry))
    with pytest.raises(InputError, match=r"network\.yaml"):
        read_network_errors(path, ["left", "stage"])


def test_rays_of_devices_meet_where_those_of_a_rig_do() -> None:
    rng = np.random.default_rng(1)
    camera = Intrinsics(640, 480, (500.0, 500.0), (322.0, 241.0), (-0.1, 0.02, 0.001, 0.0, 0.0))
    projector = Intrinsics(800, 600, (900.0, 900.0), (410.0, 500.0), (0.02, 0.0, 0.0, 0.0, 0.0))
    place = Pose.exp(np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.4]))
    other = place @ Pose.exp(np.array([0.0, 0.2, 0.0, 0.5, 0.05, 0.0]))
    rig = Calibration(camera, projector, other.inverse() @ place, "m")
    points = rng.uniform((-0.4, -0.3, 1.5), (0.4, 0.3, 3.0), (50, 3))
    matches = Pairs(camera.project(points), projector.project(rig.pose @ points) + rng.normal(0, 0.2, (50, 2)))
    devices = [
        Device(np.array([d.focal_px[0], *d.principal_point_px, *d.distortion]), pose, d.size)
        for d, pose in ((camera, place), (projector, other))
    ]
    met = meeting_points(devices[0], devices[1], matches.camera_px, matches.projector_px)
    assert np.allclose(met, place @ intersect(matches, rig).points, atol=1e-7)
    assert 0 < np.median(np.linalg.norm(met - place @ points, axis=1)) < 0.01
