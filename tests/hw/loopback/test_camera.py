"""Exposures of a simulated room that a virtual screen lights."""

import threading
import time
from typing import Any, cast

import numpy as np
import pytest

from hw.loopback import Conditions
from hw.loopback.camera import MONO_8, MONO_16, RGB_8, ExposureRequest, RoomSensor
from hw.loopback.screen import ScreenHistory
from hw.settings import SimulatedRigSettings
from hw.simulated import Sensor
from tests.support.loopback_bench import SIZE, FakeScreen, as_light


class WhiteWall:
    """Replaces a room: the camera sees the screen's light, a hundred electrons per level."""

    settings = SimulatedRigSettings()
    sensor = Sensor(0.0, 1e4, 8, full_well_electrons=25_500.0, read_noise_electrons=1.0)


def exposed(latency_s: float, request: ExposureRequest, *, change_after_s: float | None = None) -> np.ndarray:
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
    plain = exposed(0.0, ExposureRequest(20_000, 0, MONO_8, region)).mean()
    assert plain == pytest.approx(100, abs=2)
    assert exposed(0.0, ExposureRequest(40_000, 0, MONO_8, region)).mean() == pytest.approx(2 * plain, rel=0.03)
    assert exposed(0.0, ExposureRequest(20_000, 6, MONO_8, region)).mean() == pytest.approx(1.995 * plain, rel=0.03)


def test_pixel_format_and_region_take_effect() -> None:
    region = (2, 1, 3, 2)
    fine = exposed(0.0, ExposureRequest(20_000, 0, MONO_16, region))
    assert fine.shape == (2, 3)
    assert fine.mean() == pytest.approx(100 * 65535 / 255, rel=0.02)
    colour = exposed(0.0, ExposureRequest(20_000, 0, RGB_8, region))
    assert colour.shape == (2, 3, 3)
    red, green_, blue = colour.mean(axis=(0, 1))
    assert green_ > red > blue
    mosaic = exposed(0.0, ExposureRequest(20_000, 0, 0x01080009, (0, 0, *SIZE)))
    assert mosaic[0, 1] > mosaic[0, 0] > mosaic[1, 1]


def test_light_arrives_after_the_display_latency() -> None:
    """A picture that is shown during an exposure is not in it if its light takes longer than the rest."""
    request = ExposureRequest(200_000, -20, MONO_8, (0, 0, *SIZE))
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
    sensor.expose(ExposureRequest(100_000, -20, MONO_8, (0, 0, *SIZE)))
    after_ms = 1e3 * (screen.looked_s - begin_s)
    assert max(0, 100 - latency_ms) < after_ms < max(0, 100 - latency_ms) + most_ms
    assert time.monotonic() - begin_s >= 0.1
