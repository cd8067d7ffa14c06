"""Several exposures per picture: the exposure changes between frames, never within one."""

from typing import Any, cast

import numpy as np
import pytest

from hw.errors import DeviceError
from hw.rig import Capabilities, Rig, exposure_control
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedCamera
from hw.timing.devices import CameraGroup
from hw.timing.sequential import SequentialAcquisition, Timing
from hw.timing.synchronisation import synchronised
from scanner.capture import capture
from scanner.patterns import Black, White, draw, sequence_for
from tests.support.rig_bench import SIZE, Bench


class AdjustableBench(Bench):
    """Its exposure can be set, and scales its pixels."""

    capabilities = Capabilities(exposure="settable", clock=True)
    exposure_limits_us = (1000.0, 200_000.0)

    @property
    def exposure_us(self) -> float:
        return 1e6 * self.exposure_s

    def expose_for(self, exposure_us: float) -> float:
        self.log.append(f"expose for {exposure_us:.0f}")
        self.exposure_s = exposure_us / 1e6
        self._gain = self.exposure_s * 30
        return exposure_us


def test_the_exposure_changes_when_the_frame_before_has_arrived(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = AdjustableBench().install(monkeypatch)
    picture = np.full(SIZE[::-1], 200, np.uint8)
    list(
        SequentialAcquisition(bench, CameraGroup([bench]), Timing(0.05, 0.054, overlaps=True)).frames(
            [picture] * 3, (10_000.0, 20_000.0)
        )
    )
    assert [event for event in bench.log if event not in ("prepare", "flip")] == [
        *("expose for 10000", "expose", "collect"),
        *("expose for 20000", "expose", "collect"),
        *("expose for 10000", "expose", "collect"),
    ]


@pytest.mark.parametrize("latency_ms", [0, 17, 120])
@pytest.mark.parametrize("lost", [frozenset[int](), frozenset({20, 23, 24, 31})])
def test_each_frame_has_its_own_picture_and_exposure(
    monkeypatch: pytest.MonkeyPatch, latency_ms: float, lost: frozenset[int]
) -> None:
    bench = AdjustableBench(latency_ms / 1e3, lost=lost).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    pictures = list(np.random.default_rng(1).integers(0, 100, (12, *SIZE[::-1])).astype(np.uint8))
    exposures_us = (10_000.0, 30_000.0)
    lit = np.arange(SIZE[0]) % 5 != 4
    for number, frame in enumerate(rig.photograph(pictures, exposures_us)):
        share = exposures_us[number % 2] / 1e6 * 30
        np.testing.assert_allclose(
            frame.image, share * (10 + 12 * np.where(lit, pictures[number].astype(int), 0)), atol=1
        )


@pytest.mark.parametrize("latency_ms", [20, 120])
def test_the_latency_of_a_picture_is_waited_for_once(monkeypatch: pytest.MonkeyPatch, latency_ms: float) -> None:
    bench = AdjustableBench(latency_ms / 1e3, transfer_s=0.005).install(monkeypatch)
    rig = synchronised(bench, bench, {})
    patterns, exposures_us = sequence_for(SIZE, cell=4), (10_000.0, 20_000.0, 30_000.0)
    bench.log.clear()
    for number, (pattern, frame) in enumerate(capture(rig, patterns, exposures_us).frames):
        share = exposures_us[number % 3] / 1e6 * 30
        lit = np.arange(SIZE[0]) % 5 != 4
        expected = share * (10 + 12 * np.where(lit, draw(pattern, SIZE).astype(int), 0))
        np.testing.assert_allclose(frame.image, expected, atol=1)
    assert bench.log.count("flip") == len(patterns)
    per_picture_s = rig.sequential.tally.elapsed_s / len(patterns)
    assert 0 < per_picture_s - (latency_ms / 1e3 + 0.06) < 0.025  # three transfers, and a margin


def test_a_camera_whose_exposure_is_fixed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench().install(monkeypatch)
    with pytest.raises(DeviceError, match=r"every pattern with one exposure"):
        capture(Rig(bench, bench), (White(), Black()), (1000.0, 2000.0))
    with pytest.raises(DeviceError, match="cannot be changed"):
        exposure_control(bench)


def test_exposures_that_the_camera_rounds_to_one_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Coarse(AdjustableBench):
        def expose_for(self, exposure_us: float) -> float:
            return super().expose_for(max(1, round(exposure_us / 16_667)) * 16_667)

    bench = Coarse().install(monkeypatch)
    with pytest.raises(DeviceError, match="15000 and 18000 µs in exposures_us both"):
        capture(Rig(bench, bench), (White(), Black()), (15_000.0, 18_000.0))
    assert bench.exposures == 0


def test_the_simulated_camera_has_limits() -> None:
    class Room:
        settings = SimulatedRigSettings(seed=0)
        sensor = type("Sensor", (), {"exposure_us": 1e4})

    camera = SimulatedCamera(cast(Any, Room()), cast(Any, None))
    assert camera.expose_for(5000.0) == camera.exposure_us == 5000.0
    with pytest.raises(DeviceError, match="exposes for"):
        camera.expose_for(2 * camera.exposure_limits_us[1])
