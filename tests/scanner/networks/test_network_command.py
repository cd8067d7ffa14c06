"""`scan network` on captures of a synthetic network, end to end."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.geometry import Intrinsics
from calib.networks import PER_NODE, meeting_points
from calib.numerics import Bools, Floats
from calib.synthetic import RoomOptions, SyntheticNetwork, cast, random_network
from scanner.decoding import MirroredError
from scanner.io import write_png
from scanner.measuring import NetworkPoints, PointNumber
from scanner.networks import captures
from scanner.patterns import pattern_to_dict, sequence_for
from scanner.results import Decoded
from tests.support.command_line import run
from tests.support.small_capture import write_capture

_DARK, _GREY, _NEAR_M = 12.0, 190.0, 1e-6


def write_captures(folder: Path, network: SyntheticNetwork, rng: np.random.Generator) -> list[Path]:
    """Folders `<camera>-<projector>`, with noise of one grey level."""
    return [_write(folder / f"{c}-{p}", network, c, p, rng) for c, p in network.captures]


def _write(folder: Path, network: SyntheticNetwork, camera: str, projector: str, rng: np.random.Generator) -> Path:
    projector_px, lit = _seen(network, camera, projector)
    sizes = {"camera": network.devices[camera].size, "projector": network.devices[projector].size}
    (folder / "frames").mkdir(parents=True)
    frames = []
    for index, pattern in enumerate(sequence_for(sizes["projector"], cell=8, periods=(16.0,), shifts=4)):
        light = np.broadcast_to(pattern.brightness(projector_px[..., 0], projector_px[..., 1]), lit.shape)
        image = _DARK + _GREY * light * lit + rng.normal(0, 1.0, lit.shape)
        file = f"frames/{index:03d}.png"
        write_png(folder / file, np.rint(image).clip(0, 255).astype(np.uint8))
        frames.append({"file": file, "pattern": pattern_to_dict(pattern)})
    listing = {name: {"width": size.width, "height": size.height} for name, size in sizes.items()}
    (folder / "capture.yaml").write_text(yaml.safe_dump({"format": 1, **listing, "frames": frames}))
    return folder


def _seen(network: SyntheticNetwork, camera: str, projector: str) -> tuple[Floats, Bools]:
    """For each camera pixel the projector's pixel (H, W, 2) there, and whether it is lit, (H, W)."""
    width, height = network.devices[camera].size
    row, column = np.indices((height, width), dtype=np.float64)
    at, light = network.poses[camera], network.poses[projector]
    rays = network.devices[camera].unproject(np.stack([column.ravel(), row.ravel()], axis=1))
    points, _ = cast(at.rotate(rays), at.translation, network.scene)
    from_light = points - light.translation
    met, _ = cast(from_light, light.translation, network.scene)
    before = from_light @ light.rotation
    size = np.array(network.devices[projector].size)
    with np.errstate(invalid="ignore", divide="ignore"):
        projector_px = network.devices[projector].project(before)
        lit = (np.linalg.norm(met - points, axis=1) < _NEAR_M) & (before[:, 2] > 0)
        lit &= np.all((projector_px > -0.5) & (projector_px < size - 0.5), axis=1)
    return np.nan_to_num(projector_px).reshape(height, width, 2), lit.reshape(height, width)


pytestmark = pytest.mark.xdist_group("network command")  # what the module shares is made once

OPTIONS = RoomOptions(
    camera=Intrinsics(480, 400, (390.0, 390.0), (245.0, 204.0), (-0.06, 0.01, 0.0, 0.0, 0.0)),
    projector=Intrinsics(400, 250, (360.0, 360.0), (203.0, 131.0), (-0.03, 0.0, 0.0, 0.0, 0.0)),
    boxes=1,
    count=6000,
)


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> tuple[SyntheticNetwork, list[Path]]:
    rng = np.random.default_rng(3)
    network = random_network(rng, 2, 1, OPTIONS)
    return network, write_captures(tmp_path_factory.mktemp("hall"), network, rng)


def assert_measured(hall: Path, network: SyntheticNetwork) -> None:
    """Distances between pixels of both pairs, against the room: errors are as large as their sigmas say."""
    points = NetworkPoints.read(hall)
    names = [pair.name for pair in points.stations]
    assert names == ["camera1-projector1", "camera2-projector1"]
    rng = np.random.default_rng(5)
    ratios, sigmas = list[float](), list[float]()
    while len(ratios) < 60:
        first, last = (PointNumber(station, int(rng.integers(len(points.scan(station))))) for station in (0, 1))
        ends = first, last
        truth = [
            _met(network, names[end.station], points.scan(end.station).matches.camera_px[end.point]) for end in ends
        ]
        measured, true = points.distance(ends), float(np.linalg.norm(truth[1] - truth[0]))
        assert measured.budget is not None
        if abs(measured.distance - true) < 0.1 * true:  # no wrong match
            ratios.append((measured.distance - true) / measured.budget.sigma)
            sigmas.append(measured.budget.sigma / true)
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 2
    assert 1e-4 < np.median(sigmas) < 1e-2

    ends = (PointNumber(0, 100), PointNumber(1, 200))
    assert points.network_errors is not None
    budget = points.distance(ends).budget
    assert budget is not None
    assert points.network_errors.known_distance == ("camera1", "camera2")
    order = [device.name for device in points.network.devices]
    one, other, projector = (order.index(name) for name in ("camera1", "camera2", "projector1"))
    drawn = []
    matches = [points.scan(end.station).matches[np.array([end.point])] for end in ends]
    for _ in range(300):
        step = rng.multivariate_normal(np.zeros(3 * PER_NODE), points.network_errors.covariance, method="eigh")
        moved = [d.moved(step[PER_NODE * i : PER_NODE * (i + 1)]) for i, d in enumerate(points.devices)]
        there = [
            meeting_points(moved[camera], moved[projector], match.camera_px, match.projector_px)[0]
            for camera, match in zip((one, other), matches, strict=True)
        ]
        apart = np.linalg.norm(moved[other].pose.translation - moved[one].pose.translation)
        drawn.append(np.linalg.norm(there[1] - there[0]) / apart)
    before = np.linalg.norm(points.devices[other].pose.translation - points.devices[one].pose.translation)
    assert 0.85 < before * np.std(drawn) / budget.calibration < 1.15


def _met(network: SyntheticNetwork, pair: str, camera_px: Floats) -> Floats:
    """Where in the room a camera's pixel (2,) looks."""
    camera = pair.partition("-")[0]
    at = network.poses[camera]
    points, _ = cast(at.rotate(network.devices[camera].unproject(camera_px[None])), at.translation, network.scene)
    point: Floats = points[0]
    return point


def test_two_cameras_and_a_projector(taken: tuple[SyntheticNetwork, list[Path]], tmp_path: Path) -> None:
    network, folders = taken
    true = {name: pose.translation for name, pose in network.poses.items()}
    length = float(np.linalg.norm(true["camera1"] - true["camera2"]))

    assert run("network", *folders, "--out", tmp_path / "hall", "--distance", f"camera1,camera2,{length}m") == 0

    found = yaml.safe_load((tmp_path / "hall" / "network.yaml").read_text())
    devices = {each["name"]: each for each in found["devices"]}
    assert found["verdict"]["grade"] == "good"
    assert (found["unit"], set(devices)) == ("m", {"camera1", "camera2", "projector1"})
    for name, device in devices.items():
        off = device["focal_px"][0] - network.devices[name].focal_px[0]
        assert 0 < abs(off) < 3 * device["sigma"]["focal_px"][0]
        assert device["sigma"]["focal_px"][0] < 0.01 * device["focal_px"][0]
    for one, other in (("camera1", "projector1"), ("camera2", "projector1")):
        apart = np.subtract(devices[one]["translation"], devices[other]["translation"])
        assert np.linalg.norm(apart) == pytest.approx(np.linalg.norm(true[one] - true[other]), rel=0.01)
    (disagreement,) = found["disagreements"]
    # A keystone that the captures do not exclude, and that is not there, is expected as well.
    assert 0.2 < disagreement["relative"] / disagreement["expected"] < 2.0
    assert_measured(tmp_path / "hall", network)
    report = (tmp_path / "hall" / "report.html").read_text()
    assert "camera2" in report
    assert "Which camera sees whose light" in report
    assert b"network frame" in (tmp_path / "hall" / "network.ply").read_bytes()[:300]


def test_pairs_that_share_no_device_are_named(
    taken: tuple[SyntheticNetwork, list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, folders = taken
    alone = shutil.copytree(folders[1], tmp_path / "camera2-other")

    assert run("network", folders[0], alone, "--out", tmp_path / "hall") == 4

    assert "not connected with" in capsys.readouterr().err
    assert (tmp_path / "hall" / "refused.yaml").is_file()


@pytest.mark.parametrize(
    ("names", "extra", "message"),
    [
        (["a-p"], (), "needs two captures or more, found 1"),
        (["a-p", "b"], (), "expected a folder named <camera>-<projector>"),
        (["a-p", "b-c-p"], (), "expected a folder named <camera>-<projector>"),
        (["a-p", "x/a-p"], (), "all captures are of a-p"),
        (["a-p", "b-p", "x/a-p", "y/a-p", "y/b-p"], (), "x: b-p is missing, which other stations have"),
        (["a-p", "b-p"], ("--stations", "3"), "--stations captures with the devices of --config"),
        (["a-p", "p-q"], (), "'p' names a camera in one capture and a projector in another"),
        (["a-p", "b-p"], ("--distance", "a,b"), "expected two devices and a length"),
    ],
)
def test_wrong_networks_are_refused(
    names: list[str], extra: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [write_capture(tmp_path / name) for name in names]

    assert run("network", *folders, "--out", tmp_path / "hall", *extra) == 2

    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "hall").exists()


def test_two_stations_are_too_few_without_a_corner(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one/a-p", "one/b-p", "two/a-p", "two/b-p"):
        write_capture(tmp_path / name)

    assert run("network", tmp_path / "one", tmp_path / "two", "--out", tmp_path / "hall") == 4

    assert "2 stations without a corner determine no network" in " ".join(capsys.readouterr().err.split())
    assert "too-few-stations" in (tmp_path / "hall" / "refused.yaml").read_text()


def test_a_mirrored_capture_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def mirrored(*_: object) -> Decoded:
        raise MirroredError("the horizontal coordinate runs backwards")

    folders = [write_capture(tmp_path / name) for name in ("a-p", "b-p")]
    monkeypatch.setattr(captures, "decode_recording", mirrored)

    assert run("network", *folders, "--out", tmp_path / "hall") == 2

    assert "a-p: the horizontal coordinate runs backwards" in " ".join(capsys.readouterr().err.split())


def test_a_link_to_a_capture_has_its_own_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = []
    for number, name in enumerate(("a-p", "b-p")):
        target = write_capture(tmp_path / f"recording{number}")
        folders.append(tmp_path / name)
        folders[-1].symlink_to(target)
    listing = folders[1] / "capture.yaml"
    content = yaml.safe_load(listing.read_text())
    content["projector"] = {"width": 64, "height": 32}
    listing.write_text(yaml.safe_dump(content))

    assert run("network", *folders, "--out", tmp_path / "hall") == 2

    assert "p has 64 × 32 pixels here and 48 × 32 in" in " ".join(capsys.readouterr().err.split())


def test_a_device_with_two_image_sizes_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [write_capture(tmp_path / name) for name in ("a-p", "b-p")]
    listing = folders[1] / "capture.yaml"
    content = yaml.safe_load(listing.read_text())
    content["projector"] = {"width": 64, "height": 32}
    listing.write_text(yaml.safe_dump(content))

    assert run("network", *folders, "--out", tmp_path / "hall") == 2

    assert "p has 64 × 32 pixels here and 48 × 32 in" in " ".join(capsys.readouterr().err.split())
