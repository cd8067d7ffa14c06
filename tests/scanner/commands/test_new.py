"""`scan new`: commented configurations for every rig, with the found devices filled in."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from hw.aravis import AravisRigSettings
from hw.backends import BACKENDS
from hw.cameras import CameraInfo
from hw.errors import DeviceError
from hw.projector import Screen
from scanner.commands import devices, new
from scanner.commands.main import main
from scanner.commands.new import filled_in
from scanner.commands.options_of_rigs import RIGS
from scanner.configuration import load_config
from tests.support.places import ROOT

EXAMPLES = ROOT / "scanner/configuration/examples"


@pytest.fixture
def no_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> list[Screen]:
        raise DeviceError("nothing can be looked for")

    with_cameras(monkeypatch, missing)
    monkeypatch.setattr(devices, "list_screens", missing)


def with_cameras(monkeypatch: pytest.MonkeyPatch, list_cameras: Callable[[], object]) -> None:
    """Every backend finds these cameras."""
    driver = SimpleNamespace(list_cameras=list_cameras)
    monkeypatch.setattr(new, "BACKENDS", [replace(each, load=lambda: driver) for each in BACKENDS])


@pytest.mark.usefixtures("no_devices")
@pytest.mark.parametrize("rig", RIGS)
def test_the_new_configuration_is_usable_unchanged(
    rig: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine.yaml", "--rig", rig]) == 0
    said = capsys.readouterr().out
    assert ("nothing can be looked for" in said) == bool(RIGS[rig].backend)
    assert said.splitlines()[-1].startswith("→ scan ")
    assert "--config mine.yaml" in said.splitlines()[-1]
    text = Path("mine.yaml").read_text(encoding="utf-8")
    assert "configs/" not in text
    assert text.count("#") > 5
    config = load_config(Path("mine.yaml"))
    assert config == load_config(ROOT / "configs" / RIGS[rig].example)
    assert config.required_rig.backend == (RIGS[rig].backend or "simulated")


def test_found_devices_are_filled_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = ("backend: aravis", 'camera: "Maker-22345678"', "pixel_format: Mono8")
    camera = CameraInfo("Maker Model 22345678 at 10.0.0.2", "sensor 1936 × 1216", lines, (1936, 1216))
    screens = [Screen(0, "DP-1", 0, 0, 2560, 1440, 60.0), Screen(1, "HDMI-1", 2560, 0, 1280, 800, 60.0)]
    with_cameras(monkeypatch, lambda: [camera])
    monkeypatch.setattr(devices, "list_screens", lambda: screens)
    path = tmp_path / "mine.yaml"
    assert main(["new", str(path), "--rig", "aravis"]) == 0
    assert "Maker Model 22345678" in capsys.readouterr().out
    config = load_config(path)
    rig = config.required_rig
    assert isinstance(rig, AravisRigSettings)
    assert (rig.camera, rig.screen) == ("Maker-22345678", "1280x800+2560+0")
    assert (config.camera_size, config.projector_size) == ((1936, 1216), (1280, 800))
    before, after = (text.read_text(encoding="utf-8").splitlines() for text in (ROOT / "configs" / "room.yaml", path))
    assert len(before) == len(after)  # each in the place of the line that explains it
    assert sum(old != new for old, new in zip(before, after, strict=True)) <= 8


def test_a_key_without_a_commented_example_is_added() -> None:
    text = filled_in("rig:\n  # gain: 3\n  backend: aravis\n", {"rig": {"trigger": "line"}}, "here")
    assert text == "rig:\n  # gain: 3\n  trigger: line\n  backend: aravis\n"


def test_an_earlier_file_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("rig: {}\n")
    assert main(["new", str(path)]) == 2
    assert "already exists" in capsys.readouterr().err
    assert path.read_text() == "rig: {}\n"
    assert main(["new", str(path), "--overwrite"]) == 0
    assert main(["new", str(tmp_path / "mine")]) == 2
    assert "expected a name that ends with .yaml" in capsys.readouterr().err


def test_shipped_configurations_match_the_checkout() -> None:
    for rig in RIGS.values():
        assert (EXAMPLES / rig.example).samefile(ROOT / "configs" / rig.example)
