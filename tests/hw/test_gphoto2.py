"""Photo cameras, at the level of python-gphoto2's interface; no real one was tried."""

import importlib
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from hw import real_devices
from hw.backends import BACKENDS
from hw.errors import DeviceError, FrameLostError
from hw.gphoto2 import GPhotoCamera, GPhotoRigSettings
from hw.optional_parts import GPHOTO2
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedCamera, SimulatedProjector, SimulatedRoom
from hw.timing import latency, synchronisation
from scanner.capture import open_capture
from scanner.commands import devices, main
from scanner.configuration import load_config
from scanner.console import Activity, ConsoleSettings, IdlePicture, Worker
from scanner.ui import Terminal
from tests.support import fake_gphoto2
from tests.support.fake_gphoto2 import Device, GPhoto2Error
from tests.support.loopback_bench import SimulatedWindow
from tests.support.notebook import Notebook, until

pytestmark = pytest.mark.xdist_group("gphoto2")  # what the module shares is made once

SIZE, PROJECTOR = (306, 256), (160, 96)
CONFIG = f"""
rig: {{backend: gphoto2, exposure_us: 33333, refresh_hz: 60}}
camera: {{width: {SIZE[0]}, height: {SIZE[1]}}}
projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}
corner: {{squareness_deg: 0}}
"""


@pytest.fixture(scope="module")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0, interreflection=False, ambient=0), SIZE, PROJECTOR)


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch, room: SimulatedRoom) -> Device:
    """A photo camera that sees the light of the window; its projector responds at once."""
    projector = SimulatedProjector(room)
    camera = SimulatedCamera(room, projector)

    @contextmanager
    def window(*_: object) -> Iterator[SimulatedWindow]:
        yield SimulatedWindow(PROJECTOR, projector.show)

    monkeypatch.setitem(sys.modules, "gphoto2", fake_gphoto2)
    monkeypatch.setattr(real_devices, "ScreenProjector", window)
    for module in (latency, synchronisation):
        monkeypatch.setattr(module, "LONGEST_LATENCY_S", 0.0)
    fake_gphoto2.device = Device(lambda: cv2.cvtColor(camera.grab().image, cv2.COLOR_GRAY2BGR))
    return fake_gphoto2.device


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    return path


def opened(**settings: object) -> GPhotoCamera:
    return GPhotoCamera(GPhotoRigSettings.model_validate({"backend": "gphoto2", **settings}), SIZE, 60.0)


def test_a_capture_has_few_patterns_and_can_be_resumed(
    config: Path, device: Device, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = load_config(config)
    assert settings.sequence.preset == "quick"
    assert load_config(config, ["sequence.preset=standard"]).sequence.preset == "standard"
    see, frames = device.see, iter(range(10**9))

    def failing() -> np.ndarray:
        if next(frames) == 20:  # ten of them before the capture
            device.fails["capture"] = GPhoto2Error(fake_gphoto2.GP_ERROR_NO_SPACE, "Not enough free space")
        return see()

    device.see = failing
    assert main(["--config", str(config), "--out", str(config.with_name("result")), "--quiet"]) == 3
    message = " ".join(capsys.readouterr().err.split())
    assert "Canon EOS 700D: does not take a picture (Not enough free space). Its card is full." in message
    begun = config.with_name("result-incomplete")
    taken = len(open_capture(begun / "capture").patterns)
    assert taken > 0
    assert not device.open
    assert not device.files
    device.fails, device.see = {}, see
    out = config.with_name("whole")
    assert main(["--resume", str(begun), "--out", str(out), "--quiet"]) in (0, 4)
    recording = open_capture(out / "capture")
    assert recording.metadata["resumed"]["after_frames"] == taken
    assert len(recording.patterns) >= len(settings.sequence.patterns(PROJECTOR))
    assert recording.metadata["devices"]["exposure"] == "33.33 ms"
    assert device.settings["imageformat"][0] == "Large Fine JPEG"
    assert device.settings["capturetarget"][0] == "Internal RAM"


def test_the_console_shows_what_the_camera_sees(config: Path, device: Device) -> None:
    page = Notebook()
    worker = Worker(ConsoleSettings(config), page)
    worker.start()
    try:
        assert worker.request(Activity.LIVE)
        until(lambda: page.frames)
        white = page.frames[-1].image.mean()
        worker.change(picture=IdlePicture.BLACK)
        until(lambda: page.frames[-1].image.mean() < white / 2)
        worker.change(exposure_us=500_000.0)
        until(lambda: page.frames[-1].exposure_us == 5e5)
    finally:
        assert worker.close().message == ""
    assert not device.open


def test_the_shutter_speed_is_the_nearest_to_whole_refresh_periods(device: Device) -> None:
    with opened(exposure_us=70_000, iso=200) as camera:
        assert device.settings["shutterspeed"][0] == "1/15"
        assert device.settings["iso"][0] == camera.identity["iso"] == "200"
        assert camera.expose_for(400_000) == 5e5
        assert camera.exposure_limits_us == (8e3, 2e6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"autoexposuremode": ("AV", [])}, "its mode is AV. Turn its dial to M"),
        ({"batterylevel": ("5%", [])}, "its battery is at 5%"),
        ({"iso": ("100", ["100"])}, "iso '200' is not available; it offers 100"),
        ({"shutterspeed": ("auto", ["auto"])}, "its shutter speed cannot be set"),
        ({"imageformat": ("RAW", ["RAW"])}, "it sends RAW and offers nothing else"),
    ],
)
def test_settings_that_the_camera_lacks_are_named(
    device: Device, change: dict[str, tuple[str, list[str]]], words: str
) -> None:
    device.settings |= change
    with pytest.raises(DeviceError, match=words):
        opened(iso=200)
    assert not device.open


@pytest.mark.parametrize(
    ("call", "code", "words"),
    [
        ("init", fake_gphoto2.GP_ERROR_IO_USB_CLAIM, "cannot be opened .*Another program has it"),
        ("set_config", fake_gphoto2.GP_ERROR_CAMERA_BUSY, "does not take 'Internal RAM' as capturetarget"),
        ("autodetect", fake_gphoto2.GP_ERROR_CAMERA_ERROR, "searching for photo cameras failed"),
        ("file_get", fake_gphoto2.GP_ERROR_CAMERA_ERROR, "does not send its picture.*card, battery"),
    ],
)
def test_errors_of_the_library_are_named(device: Device, call: str, code: int, words: str) -> None:
    device.fails[call] = GPhoto2Error(code)
    with pytest.raises(DeviceError, match=words):
        opened().grab()


def with_size(jpeg: bytes, height: int, width: int) -> bytes:
    """The JPEG with another size in its header."""
    at = jpeg.index(b"\xff\xc0") + 5
    return jpeg[:at] + height.to_bytes(2, "big") + width.to_bytes(2, "big") + jpeg[at + 4 :]


SPOILT: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda jpeg: b"",
    "of an absurd size": lambda jpeg: with_size(jpeg, 65_500, 65_500),
    "of no size": lambda jpeg: with_size(jpeg, 0, 0),
    "cut in half": lambda jpeg: jpeg[: len(jpeg) // 2],
    "cut in half, with a preview": lambda jpeg: jpeg[:2] + jpeg + jpeg[2 : len(jpeg) // 2],
    "not an image": lambda jpeg: b"<html></html>",
}


@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT.keys())
def test_a_spoilt_file_is_a_lost_frame(device: Device, spoil: Callable[[bytes], bytes]) -> None:
    with opened() as camera:
        device.spoil = lambda _, jpeg: spoil(jpeg)
        with pytest.raises(FrameLostError, match=r"IMG_0001.JPG, [\d,]+ bytes, is not a whole image"):
            camera.grab()
        device.spoil = lambda _, jpeg: jpeg
        assert camera.grab().image.shape == (*SIZE[::-1], 3)
    assert not device.files


def test_lost_frames_are_taken_again(config: Path, device: Device) -> None:
    spoils = dict(zip((14, 17, 20, 23, 26), SPOILT.values(), strict=False))
    device.spoil = lambda number, jpeg: spoils[number](jpeg) if number in spoils else jpeg
    out = config.with_name("result")
    assert main(["--config", str(config), "--out", str(out), "--quiet"]) in (0, 4)
    recording = open_capture(out / "capture")
    assert device.taken > max(spoils)
    assert len(recording.patterns) == len(load_config(config).sequence.patterns(PROJECTOR))


def test_a_changed_size_or_camera_is_named(device: Device) -> None:
    with pytest.raises(DeviceError, match=r"no single photo camera is called 'Nikon'.*Canon EOS 700D at usb:001,005"):
        opened(camera="Nikon")
    device.see = lambda: np.zeros((10, 20, 3), np.uint8)
    with (
        opened() as camera,
        pytest.raises(DeviceError, match=r"delivers 20 × 10.*camera: \{width: 20, height: 10\}"),
    ):
        camera.grab()


def test_a_camera_is_listed_with_lines_to_paste(
    tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "list_screens", lambda: [SimulatedWindow(PROJECTOR, list).screen])
    found = devices.find_devices(Terminal(quiet=True), [each for each in BACKENDS if each.name == "gphoto2"])
    assert found.described["Cameras"][:2] == [device.model, "  photo camera at usb:001,005"]
    pasted = tmp_path / "pasted.yaml"
    pasted.write_text("\n".join(found.lines))
    rig = load_config(pasted).rig
    assert isinstance(rig, GPhotoRigSettings)
    assert rig.camera == device.model


def test_the_fake_has_the_interface_of_the_library() -> None:
    real = pytest.importorskip("gphoto2")
    for name in [name for name in vars(fake_gphoto2) if name.startswith("GP_")]:
        assert getattr(real, name) == getattr(fake_gphoto2, name), name
    for name in ("Camera", "CameraWidget", "PortInfoList", "CameraFile"):
        for method in [each for each in vars(getattr(fake_gphoto2, name)) if each.islower() and each[0] != "_"]:
            assert method == "values" or hasattr(getattr(real, name), method), f"{name}.{method}"
    error = real.GPhoto2Error(real.GP_ERROR_NO_SPACE)
    assert error.code == fake_gphoto2.GP_ERROR_NO_SPACE
    assert isinstance(error.string, str)


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gphoto2", None)
    with pytest.raises(DeviceError, match=re.escape(GPHOTO2.install_command())):
        importlib.import_module("hw.gphoto2").load()
