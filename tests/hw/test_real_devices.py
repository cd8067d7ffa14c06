"""Which devices of a network are opened, how often, and what they do together: with fakes of all of them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calib.geometry import PixelGrid
from hw import real_devices
from hw.aravis import AravisRigSettings
from hw.errors import DeviceError
from hw.opencv import OpenCVRigSettings
from hw.projector import display_of
from hw.real_devices import RealDevices, RealPair
from hw.rig import Capabilities
from tests.support.loopback_bench import SimulatedWindow

CAMERA, PROJECTOR = (8, 6), (4, 3)


@dataclass
class Bench:
    """What was opened, which is closed again, and what the screens show."""

    opened: list[str] = field(default_factory=list)
    closed: list[str] = field(default_factory=list)
    shown: dict[int, np.ndarray] = field(default_factory=dict)
    cameras: dict[str, SimpleNamespace] = field(default_factory=dict)

    @contextmanager
    def window(self, wanted: int, size: tuple[int, int], _: PixelGrid) -> Iterator[SimulatedWindow]:
        window = SimulatedWindow(size, lambda picture: self.shown.update({wanted: picture}))
        window.screen = window.screen.__class__(wanted, "screen", 0, 0, *size, 60.0 if wanted < 5 else 50.0)
        self.opened.append(f"screen {wanted}")
        try:
            yield window
        finally:
            self.closed.append(f"screen {wanted}")

    @contextmanager
    def connect(self, settings: Any, size: tuple[int, int], refresh_hz: float) -> Iterator[SimpleNamespace]:
        about = f"{settings.camera} at {settings.exposure_us} µs, {refresh_hz:g} Hz"
        self.opened.append(about)
        abilities = Capabilities(True) if settings.backend == "opencv" else Capabilities(exposure="settable")
        camera = SimpleNamespace(name=settings.camera, size=size, identity={}, capabilities=abilities)
        camera.exposure_us = settings.exposure_us
        camera.expose_for = lambda exposure_us: setattr(camera, "exposure_us", exposure_us)
        self.cameras[settings.camera] = camera
        try:
            yield camera
        finally:
            self.closed.append(about)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    bench = Bench()

    def made(kind: str) -> Callable[..., Any]:
        def rig(screen: Any, camera: Any, identity: dict[str, str], _: float, others: Any = ()) -> Any:
            cameras = [camera.name, *(other.name for other, _ in others)]
            return SimpleNamespace(kind=kind, cameras=cameras, identity=identity, stop=lambda: None)

        return rig

    driver = SimpleNamespace(load=lambda: SimpleNamespace(connect=bench.connect))
    monkeypatch.setattr(real_devices, "backend_of", lambda _: driver)
    monkeypatch.setattr(real_devices, "ScreenProjector", bench.window)
    monkeypatch.setattr(real_devices, "synchronised", made("together"))
    monkeypatch.setattr(real_devices, "streamed", made("alone"))
    return bench


def aravis(camera: str, screen: int, exposure_us: float = 16_667) -> RealPair:
    settings = AravisRigSettings(backend="aravis", camera=camera, screen=screen, exposure_us=exposure_us)
    return RealPair(settings, CAMERA, PROJECTOR)


def webcam(camera: str, screen: int) -> RealPair:
    settings = OpenCVRigSettings(backend="opencv", camera=camera, screen=screen)
    return RealPair(settings, CAMERA, PROJECTOR)


def test_each_device_is_opened_once_and_only_one_projector_shows_pictures(bench: Bench) -> None:
    pairs = {(camera, f"p{screen}"): aravis(camera, screen) for screen in (0, 1) for camera in ("a", "b")}
    with RealDevices(pairs) as devices:
        for screen, other in ((0, 1), (1, 0)):
            assert devices.together(f"p{screen}") == [["a", "b"]]
            bench.shown = {screen: np.ones(PROJECTOR[::-1], np.uint8), other: np.ones(PROJECTOR[::-1], np.uint8)}
            with devices.rig(f"p{screen}", ["a", "b"]) as rig:
                assert (rig.kind, rig.cameras) == ("together", ["a", "b"])  # type: ignore[attr-defined]
                assert rig.identity["projector"].startswith(f"screen {screen} ")
                assert bench.shown[screen].all()
                assert not bench.shown[other].any()
                assert bench.cameras["a"].exposure_us == 16_667
                bench.cameras["a"].expose_for(50_000)  # as several exposures of each pattern leave it
        assert bench.closed == []
    assert bench.opened == ["screen 0", "screen 1", "a at 16667.0 µs, 60 Hz", "b at 16667.0 µs, 60 Hz"]
    assert sorted(bench.closed) == sorted(bench.opened)


@pytest.mark.parametrize(
    ("pair", "again"),
    [(aravis("a", 1, 33_333), "a at 33333.0 µs, 60 Hz"), (aravis("a", 5), "a at 16667.0 µs, 50 Hz")],
    ids=["exposure", "refresh rate"],
)
def test_a_camera_is_opened_anew_where_a_projector_asks_for_something_else(
    bench: Bench, pair: RealPair, again: str
) -> None:
    with RealDevices({("a", "one"): aravis("a", 0), ("a", "two"): pair}) as devices:
        for projector in ("one", "two"):
            with devices.rig(projector, ["a"]):
                pass
        assert bench.closed == ["a at 16667.0 µs, 60 Hz"]
    assert bench.opened[2:] == ["a at 16667.0 µs, 60 Hz", again]
    assert sorted(bench.closed) == sorted(bench.opened)


def test_streaming_cameras_capture_one_at_a_time(bench: Bench) -> None:
    pairs = {("w", "p"): webcam("w", 0), ("a", "p"): aravis("a", 0), ("v", "p"): webcam("v", 0)}
    pairs |= {("b", "p"): aravis("b", 0)}
    with RealDevices(pairs) as devices:
        assert devices.together("p") == [["a", "b"], ["w"], ["v"]]
        with devices.rig("p", ["w"]) as rig:
            assert rig.kind == "alone"  # type: ignore[attr-defined]
    assert len(bench.opened) == len(bench.closed) == 5


def test_two_projectors_on_one_screen_are_refused_and_all_is_closed(bench: Bench) -> None:
    with (
        pytest.raises(DeviceError, match="one and two are both on screen 0"),
        RealDevices({("a", "one"): aravis("a", 0), ("a", "two"): aravis("a", 0)}),
    ):
        pass
    assert sorted(bench.closed) == sorted(bench.opened)


def test_only_x_display_names_are_recognised() -> None:
    assert [display_of(name) for name in (":0.1", ":12")] == [":0.1", ":12"]
    assert [display_of(name) for name in (None, 1, "HDMI-1", "320x180+0+0", "a:1")] == [None] * 5
