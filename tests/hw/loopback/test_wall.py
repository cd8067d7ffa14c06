"""When the pictures of a virtual screen are on the wall."""

from concurrent.futures import Future

import numpy as np
import pytest

from hw.loopback import Conditions
from hw.loopback.screen import Wall
from tests.support.simulated_window import SIZE


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
