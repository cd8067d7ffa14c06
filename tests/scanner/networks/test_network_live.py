"""A network that captures itself: two cameras and two projectors in one simulated room."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.geometry import Size
from hw.errors import DeviceError
from hw.rig import Frame
from hw.simulated import SimulatedCamera
from scanner.capture import open_capture
from scanner.commands import main as scan
from scanner.configuration import load_config
from scanner.io import read_calibration

pytestmark = pytest.mark.xdist_group("network live")  # what the module shares is made once

_CAMERAS = ("left", "right")
HALL = Path(__file__).parents[3] / "configs" / "hall-sim.yaml"
SMALL = ["camera.width=306", "camera.height=256", "projector.width=320", "projector.height=180", "rig.ambient=0"]
SETTINGS = [word for each in SMALL for word in ("--set", each)]


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("network") / "hall"
    assert scan(["network", "--config", str(HALL), *SETTINGS, "--out", str(out), "--quiet"]) == 0
    return out


def test_every_device_is_estimated_correctly(taken: Path) -> None:
    document = yaml.safe_load((taken / "network.yaml").read_text(encoding="utf-8"))
    found = {each["name"]: each for each in document["devices"]}
    assert {*found} == {"left", "right", "stage", "side"}
    for camera, projector in (("left", "stage"), ("right", "side")):
        truth = read_calibration(taken / "captures" / f"{camera}-{projector}" / "truth.yaml")
        for name, device in ((camera, truth.camera), (projector, truth.projector)):
            off = found[name]["focal_px"][0] / device.focal_px[0] - 1
            sigma = found[name]["sigma"]["focal_px"][0] / device.focal_px[0]
            assert 1e-5 < sigma < 0.01
            assert abs(off) < 4 * sigma
    assert found["left"]["focal_px"][0] < 0.97 * found["right"]["focal_px"][0]


def test_replaying_the_captures_gives_the_same_network(taken: Path, tmp_path: Path) -> None:
    pairs = sorted(map(str, (taken / "captures").iterdir()))
    assert [Path(pair).name for pair in pairs] == ["left-side", "left-stage", "right-side", "right-stage"]
    again = tmp_path / "again"
    assert scan(["network", *pairs, "--config", str(HALL), *SETTINGS, "--out", str(again), "--quiet"]) == 0
    first, second = (yaml.safe_load((each / "network.yaml").read_text(encoding="utf-8")) for each in (taken, again))
    for one, other in zip(*(sorted(each["devices"], key=_name) for each in (first, second)), strict=True):
        assert one["name"] == other["name"]
        np.testing.assert_allclose(one["focal_px"], other["focal_px"], rtol=1e-6)


def _name(device: dict[str, str]) -> str:
    return device["name"]


def test_a_pair_merges_common_and_device_keys() -> None:
    config = load_config(HALL, ["rigs.cameras.right.camera={width: 640, height: 480}"])
    pairs = config.pairs
    assert [*pairs] == [("left", "stage"), ("right", "stage"), ("left", "side"), ("right", "side")]
    assert [own.camera_size for own in pairs.values()] == [Size(480, 400), Size(640, 480)] * 2
    places = [
        (own.required_rig.model_dump()["pose"], own.required_rig.model_dump()["projector_pose"])
        for own in pairs.values()
    ]
    assert places == [(0, 0), (1, 0), (0, 1), (1, 1)]
    assert all(own.required_rig.model_dump()["seed"] == 3 for own in pairs.values())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("rigs=null", "no 'rigs'"),
        ("rigs.cameras.left.rig.poze=1", "rigs: left with stage: unknown key 'rig.poze'"),
        ("rigs.cameras={le-ft: {}}", "is no name of a device"),
        ("rigs.cameras.left.rig={backend: opencv, device: 0}", "'rig"),
        ("rigs.cameras={stage: {}}", "the same name"),
        ("rigs={cameras: {left: {}}, projectors: {stage: {}}}", "two pairs of devices or more"),
        ("rigs.projectors.side.camera={width: 320, height: 240}", "left has 320 × 240 pixels with left and side"),
    ],
)
def test_impossible_settings_are_named_before_a_capture(
    change: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert scan(["network", "--config", str(HALL), "--set", change, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_captures_or_devices_are_required(capsys: pytest.CaptureFixture[str]) -> None:
    assert scan(["network"]) == 2
    assert "--config" in capsys.readouterr().err


def test_each_projector_shows_its_sequence_once(taken: Path) -> None:
    for projector in ("stage", "side"):
        left, right = (open_capture(taken / "captures" / f"{camera}-{projector}" / "capture") for camera in _CAMERAS)
        assert left.patterns == right.patterns == left.planned
        assert len(left.patterns) > 20


def test_a_camera_failure_keeps_the_frames_of_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, grabbed = SimulatedCamera.grab, list[SimulatedCamera]()

    def failing(camera: SimulatedCamera) -> Frame:
        if grabbed.count(camera) == 20 and camera is not grabbed[0]:
            raise DeviceError("the cable is out")
        grabbed.append(camera)
        return whole(camera)

    monkeypatch.setattr(SimulatedCamera, "grab", failing)
    assert scan(["network", "--config", str(HALL), *SETTINGS, "--out", str(tmp_path / "out"), "--quiet"]) == 3
    assert "0 of 2 captures are whole, and scan network takes those" in capsys.readouterr().err
    (kept,) = tmp_path.glob("out-incomplete*")
    found = {each.parent.name: open_capture(each) for each in kept.glob("captures/*/capture")}
    assert {*found} == {"left-stage", "right-stage"}
    of_left, of_right = (found[name].patterns for name in ("left-stage", "right-stage"))
    assert len(of_left) == len(of_right) > 10
    assert of_left == found["left-stage"].planned[: len(of_left)]
