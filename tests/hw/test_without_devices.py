"""Without Aravis, pyglet or a desktop: whatever needs them reports it, and everything else works."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

from hw.aravis import AravisRigSettings
from hw.aravis import backend as aravis
from hw.errors import DeviceError
from hw.open_rig import open_rig
from hw.optional_parts import RIG
from hw.projector import ScreenProjector, list_screens
from scanner.commands import devices, main
from scanner.configuration import load_config
from scanner.errors import InputError
from tests.support.places import ROOT


@pytest.fixture
def no_aravis(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)
    for module in ("hw.aravis.camera", "hw.aravis.setup", "hw.aravis.devices"):
        monkeypatch.delitem(sys.modules, module, raising=False)
        monkeypatch.delattr(module, raising=False)


@pytest.fixture
def no_pyglet(monkeypatch: pytest.MonkeyPatch) -> None:
    find_spec = importlib.util.find_spec
    found = lambda name, *more: None if name == "pyglet" else find_spec(name, *more)  # noqa: E731
    monkeypatch.setattr(importlib.util, "find_spec", found)


@pytest.mark.usefixtures("no_aravis")
def test_missing_aravis_is_named_with_its_packages() -> None:
    with pytest.raises(DeviceError, match=re.escape(f"type: {RIG.install_command()}")):
        aravis.load()


@pytest.mark.usefixtures("no_pyglet")
def test_missing_pyglet_is_named() -> None:
    for ask in (list_screens, lambda: ScreenProjector(None, (854, 480))):
        with pytest.raises(
            DeviceError, match=re.escape(f"pyglet, which is not installed; type: {RIG.install_command()}")
        ):
            ask()


@pytest.mark.usefixtures("no_aravis", "no_pyglet")
def test_devices_say_what_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices"]) == 3
    output = capsys.readouterr()
    assert output.out.count(RIG.install_command()) == 2
    assert output.err.startswith("scan: neither cameras nor screens were found")


@pytest.mark.usefixtures("no_aravis")
def test_screens_are_listed_without_aravis(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(devices, "list_screens", list)
    assert main(["devices"]) == 0
    assert "Screens\n  none found" in capsys.readouterr().out


@pytest.mark.usefixtures("no_aravis")
def test_a_scan_with_real_devices_stops_before_anything_is_shown() -> None:
    with (
        pytest.raises(DeviceError, match="Aravis with PyGObject"),
        open_rig(AravisRigSettings(backend="aravis"), (640, 480), (854, 480)),
    ):
        pass


def test_a_missing_desktop_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    if importlib.util.find_spec("pyglet") is None:
        pytest.skip("pyglet is not installed")
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(DeviceError, match=r"on the display ':4711'.*Cannot connect"):
        list_screens()


@pytest.mark.parametrize("name", ["room.yaml", "room-loopback.yaml"])
def test_shipped_configurations_are_valid(name: str) -> None:
    config = load_config(ROOT / "configs" / name)
    assert isinstance(config.required_rig, AravisRigSettings)
    assert config.principal_point(config.camera_size)


def test_shipped_configurations_explain_every_key() -> None:
    text = (ROOT / "configs" / "room.yaml").read_text()
    for key in AravisRigSettings.model_fields:
        assert re.search(rf"^  (# )?{key}: ", text, re.MULTILINE), key


def test_optional_keys_of_a_configuration_can_be_uncommented(tmp_path: Path) -> None:
    path = tmp_path / "room.yaml"
    lines = (ROOT / "configs" / "room.yaml").read_text().splitlines()
    key = re.compile(r"^(  )# (\w+: \S.*)$")
    wanted = [key.sub(r"\1\2", line) if "free-run" not in line and "software:" not in line else line for line in lines]
    path.write_text("\n".join(wanted))
    rig = load_config(path).required_rig
    assert isinstance(rig, AravisRigSettings)
    assert (rig.camera, rig.packet_size, rig.screen, rig.offset_px) == ("22345678", 8000, "HDMI-1", (0, 0))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("gian: 3", "unknown key 'rig.gian'; did you mean 'rig.gain'"),
        ("exposure_us: 0", "'rig.exposure_us'"),
        ("trigger: hardware", "'software', 'line' or 'free-run'"),
        ("latency_ms: 50", "unknown key 'rig.latency_ms'"),
        ("seed: 3", "unknown key 'rig.seed'; it belongs to another kind"),
        ("packet_size: 100", "'rig.packet_size'"),
    ],
)
def test_wrong_keys_are_named(tmp_path: Path, more: str, words: str) -> None:
    path = tmp_path / "room.yaml"
    path.write_text(f"rig: {{backend: aravis, {more}}}")
    with pytest.raises(InputError) as caught:
        load_config(path)
    assert words in str(caught.value)


def test_serial_numbers_of_digits_are_read_as_text() -> None:
    rig = load_config(None, ["rig={backend: aravis, camera: 22345678}"]).required_rig
    assert isinstance(rig, AravisRigSettings)
    assert rig.camera == "22345678"
