"""The loopback rig of a network: which devices are served, and where the command finds them."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import module_from_spec, spec_from_file_location
from types import SimpleNamespace
from typing import Any

import pytest

from hw.errors import DeviceError
from hw.loopback import LoopbackSettings
from scanner.configuration import load_config
from tests.support.places import ROOT

HALL = ROOT / "configs" / "hall-loopback.yaml"


@pytest.fixture(scope="module")
def on_loopback() -> Any:
    spec = spec_from_file_location("on_loopback", ROOT / "tools" / "on_loopback.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_name_gets_a_device(on_loopback: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[LoopbackSettings] = []

    @contextmanager
    def network(
        cameras: Sequence[LoopbackSettings], sizes: Sequence[tuple[int, int]]
    ) -> Iterator[list[SimpleNamespace]]:
        served.extend(cameras)
        yield [SimpleNamespace(display=f":{number}") for number, _ in enumerate(sizes, start=7)]

    monkeypatch.setattr(on_loopback, "loopback_network", network)
    monkeypatch.setattr(on_loopback, "own_addresses", lambda: ["127.0.0.1", "192.0.2.1"])
    config = load_config(HALL, ["rigs.cameras.right.camera={width: 306, height: 256}"])
    with on_loopback._devices(config, LoopbackSettings(camera_size=(8, 6))) as more:
        again = load_config(HALL, more[1::2])
    assert {*more[::2]} == {"--set"}
    found = {pair: own.required_rig.model_dump() for pair, own in again.pairs.items()}
    assert {pair: (rig["camera"], rig["screen"]) for pair, rig in found.items()} == {
        ("left", "stage"): ("127.0.0.1", ":7"),
        ("right", "stage"): ("192.0.2.1", ":7"),
        ("left", "side"): ("127.0.0.1", ":8"),
        ("right", "side"): ("192.0.2.1", ":8"),
    }
    assert [(each.serial, each.address, each.camera_size, each.room.pose) for each in served] == [
        ("left", "127.0.0.1", (480, 400), 0),
        ("right", "192.0.2.1", (306, 256), 1),
    ]
    assert {each.projector_poses for each in served} == {(0, 1)}


def test_more_cameras_than_addresses_are_refused(on_loopback: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(on_loopback, "own_addresses", lambda: ["127.0.0.1"])
    with (
        pytest.raises(DeviceError, match="2 cameras need as many addresses"),
        on_loopback._devices(load_config(HALL), LoopbackSettings(camera_size=(8, 6))),
    ):
        pass
