"""Start times of exposures from a camera's time stamps and arrival times."""

import numpy as np
import pytest

from hw.aravis.frame_clock import FrameClock

EXPOSURE_S, INTERVAL_S, OFFSET_S, READOUT_S = 0.03, 0.04, 1.7e9, 0.012


def test_exposure_starts_are_right_up_to_a_constant() -> None:
    clock, rng = FrameClock(), np.random.default_rng(0)
    late_s = []
    for number in range(200):
        begun_s = number * INTERVAL_S
        held_up_s = 0.03 * rng.random() ** 2
        came_s = begun_s + EXPOSURE_S + READOUT_S + held_up_s
        late_s.append(clock.begun_s(number, begun_s + OFFSET_S, came_s, EXPOSURE_S) - begun_s)
    assert late_s[20:] == pytest.approx([READOUT_S] * 180, abs=1.5e-3)
    assert clock.interval_s == pytest.approx(INTERVAL_S, abs=1e-6)
    assert clock.has_time_stamps


def test_lost_frames_do_not_change_the_interval() -> None:
    clock = FrameClock()
    for number in (0, 1, 4, 5, 9):
        clock.begun_s(number, number * INTERVAL_S, 1 + number * INTERVAL_S, EXPOSURE_S)
    assert clock.interval_s == pytest.approx(INTERVAL_S)


def test_a_camera_without_time_stamps_gives_no_interval() -> None:
    clock = FrameClock()
    for number in range(5):
        clock.begun_s(number, 0.0, number * INTERVAL_S, EXPOSURE_S)
    assert not clock.has_time_stamps
    assert clock.interval_s == float("inf")
