"""The virtual screen of the loopback rig, and the history of what it showed.

When the pictures of a virtual screen are on the wall.
"""

import time
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

from hw.loopback import Conditions
from hw.loopback.screen import ScreenHistory, Wall, XwdScreen, green
from tests.support.loopback_bench import SIZE, FakeScreen, as_light


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
