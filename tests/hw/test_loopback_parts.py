"""The parts of the loopback rig that need neither an X server nor Aravis."""

import threading
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from hw.loopback.exposure import MONO_8, MONO_16, RGB_8, Request, RoomSensor
from hw.loopback.screen import ScreenHistory, XwdScreen, green
from hw.loopback.settings import Conditions
from hw.loopback.wall import Wall
from hw.settings import SimulatedRigSettings
from hw.simulated.sensor import Sensor

SIZE = (6, 4)


class FakeScreen:
    """A screen that a test draws on; `looked_s`: time of the last look at it."""

    def __init__(self) -> None:
        self.level = 0
        self.looked_s = 0.0

    def pixels(self) -> np.ndarray:
        self.looked_s = time.monotonic()
        return np.full(SIZE[::-1], self.level * 0x010101, np.uint32)


def as_light(image: np.ndarray) -> np.ndarray:
    return image.astype(np.float32)


def xwd(path: Path, pixels: np.ndarray, colours: int = 3, padding: int = 8) -> Path:
    height, width = pixels.shape
    words = [100 + 4, 7, 2, 24, width, height, 0, 0, 32, 0, 32, 32, 4 * width + padding, 4, 0, 0, 0, 8, 256, colours]
    header = np.array([*words, width, height, 0, 0, 0], ">u4").tobytes() + b"name"
    lines = np.pad(pixels.astype("<u4").view(np.uint8).reshape(height, -1), ((0, 0), (0, padding)))
    path.write_bytes(header + bytes(12 * colours) + lines.tobytes())
    return path


def test_an_xwd_file_is_read(tmp_path: Path) -> None:
    grey = np.random.default_rng(0).integers(0, 256, (5, 7)).astype(np.uint32)
    screen = XwdScreen(xwd(tmp_path / "screen", grey * 0x010101))
    assert screen.size == (7, 5)
    np.testing.assert_array_equal(green(screen.pixels()), grey)


def test_another_file_type_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "screen"
    path.write_bytes(bytes(200))
    with pytest.raises(ValueError, match="xwd version 7"):
        XwdScreen(path)


def test_an_exposure_mixes_the_pictures_shown_during_it() -> None:
    screen = FakeScreen()
    history = ScreenHistory(screen, as_light)
    before = time.monotonic()
    screen.level = 200
    history.look()
    after = time.monotonic()
    (early, dark), (late, bright) = history.shares(before - 1.0, after + 3.0)
    assert (dark.max(), bright.min()) == (0, 200)
    assert early + late == pytest.approx(1)
    assert early == pytest.approx(1 / 4, abs=0.05)
    assert [light.max() for _, light in history.shares(before - 2, before - 1)] == [0]
    assert [light.max() for _, light in history.shares(after, after + 1)] == [200]


def test_a_change_does_not_affect_an_earlier_exposure() -> None:
    screen = FakeScreen()
    history = ScreenHistory(screen, as_light)
    history.look()
    end = time.monotonic()
    history.look()
    screen.level = 255
    time.sleep(0.02)
    history.look()
    assert [light.max() for _, light in history.shares(end - 1, end)] == [0]


def test_changes_are_recorded_in_the_background() -> None:
    screen = FakeScreen()
    with ScreenHistory(screen, as_light) as history:
        for level in (50, 100, 150):
            time.sleep(0.05)
            screen.level = level
        time.sleep(0.05)
    now = time.monotonic()
    assert [light.max() for _, light in history.shares(now - 1, now)] == [0, 50, 100, 150]


class WhiteWall:
    """Replaces a room: the camera sees the screen's light, a hundred electrons per level."""

    settings = SimulatedRigSettings()
    sensor = Sensor(0.0, 1e4, 8, full_well_electrons=25_500.0, read_noise_electrons=1.0)


def exposed(latency_s: float, request: Request, *, change_after_s: float | None = None) -> np.ndarray:
    screen = FakeScreen()
    with ScreenHistory(screen, lambda image: 100 * as_light(image)) as history:
        sensor = RoomSensor(cast(Any, WhiteWall()), history, white_exposure_us=20_000)
        history.wall.conditions = Conditions(latency_ms=1e3 * latency_s)
        screen.level = 0 if change_after_s is not None else 100
        time.sleep(0.02 + latency_s)
        if change_after_s is not None:
            threading.Timer(change_after_s, lambda: setattr(screen, "level", 100)).start()
        data = sensor.expose(request)
    kind = np.uint16 if request.pixel_format == MONO_16 else np.uint8
    channels = (3,) if request.pixel_format == RGB_8 else ()
    return np.frombuffer(data, kind).reshape(request.region[3], request.region[2], *channels)


def test_a_longer_exposure_and_more_gain_are_brighter() -> None:
    region = (0, 0, *SIZE)
    plain = exposed(0.0, Request(20_000, 0, MONO_8, region)).mean()
    assert plain == pytest.approx(100, abs=2)
    assert exposed(0.0, Request(40_000, 0, MONO_8, region)).mean() == pytest.approx(2 * plain, rel=0.03)
    assert exposed(0.0, Request(20_000, 6, MONO_8, region)).mean() == pytest.approx(1.995 * plain, rel=0.03)


def test_pixel_format_and_region_take_effect() -> None:
    region = (2, 1, 3, 2)
    fine = exposed(0.0, Request(20_000, 0, MONO_16, region))
    assert fine.shape == (2, 3)
    assert fine.mean() == pytest.approx(100 * 65535 / 255, rel=0.02)
    colour = exposed(0.0, Request(20_000, 0, RGB_8, region))
    assert colour.shape == (2, 3, 3)
    red, green_, blue = colour.mean(axis=(0, 1))
    assert green_ > red > blue
    mosaic = exposed(0.0, Request(20_000, 0, 0x01080009, (0, 0, *SIZE)))
    assert mosaic[0, 1] > mosaic[0, 0] > mosaic[1, 1]


def test_light_arrives_after_the_display_latency() -> None:
    """A picture that is shown during an exposure is not in it if its light takes longer than the rest."""
    request = Request(200_000, -20, MONO_8, (0, 0, *SIZE))
    half = exposed(0.0, request, change_after_s=0.1).mean()
    assert 30 < half < 70
    assert exposed(0.15, request, change_after_s=0.1).mean() < 3


@pytest.mark.parametrize(("latency_ms", "most_ms"), [(0, 100), (80, 30), (200, 30)])
def test_a_frame_is_computed_before_its_exposure_ends(latency_ms: float, most_ms: float) -> None:
    """It is computed once no other light can arrive, so that it is ready in time."""
    screen = FakeScreen()
    history = ScreenHistory(screen, lambda image: 100 * as_light(image))
    history.wall.conditions = Conditions(latency_ms=latency_ms)
    sensor = RoomSensor(cast(Any, WhiteWall()), history, white_exposure_us=20_000)
    begin_s = time.monotonic()
    sensor.expose(Request(100_000, -20, MONO_8, (0, 0, *SIZE)))
    after_ms = 1e3 * (screen.looked_s - begin_s)
    assert max(0, 100 - latency_ms) < after_ms < max(0, 100 - latency_ms) + most_ms
    assert time.monotonic() - begin_s >= 0.1


def done(level: int) -> Future[np.ndarray]:
    light: Future[np.ndarray] = Future()
    light.set_result(np.full(SIZE[::-1], level, np.float32))
    return light


def seen_on(wall: Wall, begin_s: float, end_s: float) -> dict[int, float]:
    return {int(light.result().max()): share for share, light in wall.shares(begin_s, end_s)}


def test_several_pictures_are_in_the_pipeline() -> None:
    wall = Wall(done(0), seed=0)
    wall.conditions = Conditions(latency_ms=120)
    for number in range(1, 5):
        wall.send(number * 0.04, done(number))
    assert seen_on(wall, 0.0, 0.16) == {0: pytest.approx(1)}
    assert seen_on(wall, 0.14, 0.22) == {0: pytest.approx(1 / 4), 1: pytest.approx(1 / 2), 2: pytest.approx(1 / 4)}
    assert seen_on(wall, 0.3, 0.5) == {4: pytest.approx(1)}


def test_late_pictures_keep_their_order() -> None:
    wall = Wall(done(0), seed=1)
    wall.conditions = Conditions(latency_ms=50, jitter_ms=10, missed_refreshes=0.3)
    times = []
    for number in range(1, 60):
        wall.send(number * 0.02, done(number))
        times.append(wall._pictures[-1].since_s)
    late_s = np.array(times) - np.arange(1, 60) * 0.02
    assert np.all(np.diff(times) >= 0)
    assert 0.05 <= late_s.min() < 0.052
    assert 0.06 < late_s.max() < 0.05 + 0.01 + 1 / 60
    wall.conditions = Conditions(latency_ms=0)
    wall.send(1.2, done(60))
    assert wall._pictures[-1].since_s >= times[-1]


def test_a_slow_panel_approaches_the_next_picture_exponentially() -> None:
    wall = Wall(done(0), seed=0)
    wall.conditions = Conditions(latency_ms=0, settling_ms=10)
    wall.send(1.0, done(1))
    wall.send(1.02, done(2))
    moments = np.linspace(1.0, 1.06, 6001)
    left = np.exp(-(moments - 1) / 0.01)
    of_first = np.where(moments < 1.02, 1 - left, (1 - np.exp(-2)) * np.exp(-(moments - 1.02) / 0.01))
    expected = {0: left.mean(), 1: of_first.mean(), 2: (1 - left - of_first).mean()}
    assert seen_on(wall, 1.0, 1.06) == pytest.approx(expected, abs=1e-3)
