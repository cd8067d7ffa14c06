"""`scan network` on stations without a corner. Single pairs' calibrations are given here; `calib.scene` makes them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.geometry import Intrinsics
from calib.refinement import SHARED, KnownRig, State, device_of
from calib.refusal import RefusalError
from calib.scene import ONE_AXIS
from calib.synthetic import RoomOptions, SyntheticNetwork, random_network
from scanner.configuration import Config
from scanner.networks import Captures, job, solve
from scanner.results import Decoded
from tests.scanner.networks.test_network_command import write_captures
from tests.support.command_line import run
from tests.support.places import ROOT

pytestmark = pytest.mark.xdist_group("network scenes")  # what the module shares is made once

_SIGMA = np.array([1e-3, 1, 1, 5e-3, 5e-3, 3e-4, 3e-4, 5e-3] * 2 + [1e-3] * 5) / 20
_CAMERAS = ("camera1", "camera2")
_OPTIONS = RoomOptions(
    camera=Intrinsics(240, 200, (195.0, 195.0), (122.0, 102.0), (-0.06, 0.01, 0.0, 0.0, 0.0)),
    projector=Intrinsics(200, 125, (180.0, 180.0), (101.0, 65.0), (-0.03, 0.0, 0.0, 0.0, 0.0)),
    boxes=1,
    count=6000,
)


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> tuple[SyntheticNetwork, list[Path]]:
    """Three stations, at which nothing was turned."""
    rng = np.random.default_rng(3)
    network = random_network(rng, 2, 1, _OPTIONS)
    folder = tmp_path_factory.mktemp("stations")
    stations = [folder / name for name in ("one", "two", "three")]
    for station in stations:
        write_captures(station, network, rng)
    return network, stations


def calibrating(network: SyntheticNetwork, but: Sequence[str] = ()) -> Callable[[Sequence[Decoded], Config], KnownRig]:
    """Calibrates the pairs in their order, with errors; refuses those of some cameras."""
    cameras, rng = iter(_CAMERAS), np.random.default_rng(5)

    def calibrate(stations: Sequence[Decoded], _: Config) -> KnownRig:
        assert len(stations) == 3
        camera = next(cameras)
        if camera in but:
            raise RefusalError(ONE_AXIS, "All turns are about one axis.", ONE_AXIS.remedy)
        pose = (network.poses["projector1"].inverse() @ network.poses[camera]).in_baselines
        state = State(device_of(network.devices[camera]), device_of(network.devices["projector1"]), pose)
        return KnownRig(state.moved(_SIGMA * rng.normal(0, 1, SHARED)), np.diag(_SIGMA**2))

    return calibrate


@pytest.mark.parametrize("but", [[], ["camera2"]])
def test_stations_calibrate_a_network(
    but: list[str], taken: tuple[SyntheticNetwork, list[Path]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a pair is not calibrated by itself: it follows by shared light."""
    network, stations = taken
    monkeypatch.setattr(solve, "known_rig", calibrating(network, but))
    out = tmp_path / "hall"

    assert run("network", *stations, "--out", out) == 0

    document = yaml.safe_load((out / "network.yaml").read_text(encoding="utf-8"))
    devices = {device["name"]: device for device in document["devices"]}
    assert set(devices) == set(network.devices)
    for name, device in devices.items():
        sigma = device["sigma"]["focal_px"][0]
        assert 1e-5 < sigma / device["focal_px"][0] < (5e-3 if but else 1.1e-4)
        assert abs(device["focal_px"][0] - network.devices[name].focal_px[0]) < 4 * sigma
    kinds = [finding["kind"] for finding in document["findings"]]
    assert kinds.count("network-by-scene") == 1
    assert kinds.count("pair-follows") == len(but)
    assert document["planes"] == []
    assert (out / "captures" / "camera1-projector1" / "matches.npz").is_file()
    assert (out / "captures" / "3" / "camera2-projector1" / "matches.npz").is_file()
    for cloud in ("network.ply", "captures/2/network.ply", "captures/3/network.ply"):
        assert b"network frame" in (out / cloud).read_bytes()[:300]


def test_something_that_moved_at_one_station_is_named(
    taken: tuple[SyntheticNetwork, list[Path]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One camera's capture of the last station is of another room's corner and boxes."""
    network, stations = taken
    other = random_network(np.random.default_rng(3), 2, 1, replace(_OPTIONS, boxes=4))
    for pair in ("camera1-projector1", "camera2-projector1"):
        (tmp_path / "changed").mkdir(exist_ok=True)
        (tmp_path / "changed" / pair).symlink_to(stations[2] / pair)
    (tmp_path / "changed" / "camera2-projector1").unlink()
    moved = write_captures(tmp_path / "moved", replace(network, scene=other.scene), np.random.default_rng(4))
    (tmp_path / "changed" / "camera2-projector1").symlink_to(moved[1])
    monkeypatch.setattr(solve, "known_rig", calibrating(network))

    run("network", *stations[:2], tmp_path / "changed", "--out", tmp_path / "hall")

    document = yaml.safe_load((tmp_path / "hall" / "network.yaml").read_text(encoding="utf-8"))
    (finding,) = [finding for finding in document["findings"] if finding["kind"] == "station-changed"]
    assert finding["message"].startswith("at station 3, camera1 and camera2 see ")
    assert 0.02 < finding["data"]["elsewhere_share"] < 0.9


def test_a_network_of_which_no_pair_is_calibrated_says_why(
    taken: tuple[SyntheticNetwork, list[Path]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    network, stations = taken
    monkeypatch.setattr(solve, "known_rig", calibrating(network, _CAMERAS))

    assert run("network", *stations, "--out", tmp_path / "hall") == 4

    error = " ".join(capsys.readouterr().err.split())
    assert "camera1 in the light of projector1: All turns are about one axis. Tip the object once" in error


def test_nothing_that_was_turned_is_refused(
    taken: tuple[SyntheticNetwork, list[Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, stations = taken

    assert run("network", *stations, "--out", tmp_path / "hall") == 4

    assert "at the same place" in " ".join(capsys.readouterr().err.split())


def test_stations_of_configured_devices_are_taken_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken = list[Captures]()

    def solved(captures: Captures, *_: object) -> None:
        taken.append(captures)
        raise RefusalError(ONE_AXIS, "All turns are about one axis.", ONE_AXIS.remedy)

    monkeypatch.setattr(job, "solve_network", solved)
    sizes = ["camera={width: 120, height: 100}", "projector={width: 107, height: 60}"]
    settings = [word for size in sizes for word in ("--set", size)]
    config = ROOT / "configs" / "thing-network-sim.yaml"
    out = tmp_path / "thing"

    assert run("network", "--config", config, *settings, "--stations", "3", "--out", out) == 4

    (captures,) = taken
    assert [set(station) for station in captures.stations] == [{("left", "stage"), ("right", "stage")}] * 3
    counts = {len(station[pair].matches) for station in captures.stations for pair in station}
    assert len(counts) == 6  # of an object that turned, from two sides
    assert min(counts) > 500
    for place in ("", "2", "3"):
        assert (out / "captures" / place / "right-stage" / "capture" / "capture.yaml").is_file()
