"""The virtual screen of the loopback rig, and the history of what it showed."""

import time
from pathlib import Path

import numpy as np
import pytest

from hw.loopback.screen import ScreenHistory, XwdScreen, green
from tests.support.simulated_window import FakeScreen, as_light


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
