"""Exposures that change while a real camera runs."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from calib.numerics import Image
from hw.errors import DeviceError
from hw.open_rig import open_rig
from hw.rig import Rig, exposure_control
from hw.simulated import SimulatedRoom
from scanner.capture import capture, open_capture
from scanner.checking import propose_exposure
from scanner.configuration import load_config
from scanner.patterns import Black, Pattern, White, draw
from tests.support.loopback_bench import CAMERA, CONFIG, PROJECTOR, Loopback, scan

pytestmark = [pytest.mark.xdist_group("loopback"), pytest.mark.usefixtures("capture_only")]

PERIOD_US = 1e6 / 60


@pytest.fixture
def opened(config: Path, rig: Loopback) -> Iterator[Rig]:
    settings = load_config(config)
    with open_rig(settings.required_rig, settings.camera_size, settings.projector_size) as opened:
        yield opened.rig


def test_an_exposure_is_a_whole_number_of_refresh_periods_as_the_camera_reads_it_back(opened: Rig) -> None:
    camera = exposure_control(opened.camera)
    for wanted_us, periods in ((50_000, 3), (20_000, 1), (1000, 1), (66_000, 4)):
        found_us = camera.expose_for(wanted_us)
        assert found_us == camera.exposure_us == pytest.approx(periods * PERIOD_US, rel=1e-3)
        (frame,) = opened.photograph([draw(White(), PROJECTOR)])  # again, if a busy computer triggered it late
        assert frame.exposure_us == found_us
    shortest, longest = camera.exposure_limits_us
    assert shortest < PERIOD_US < longest
    with pytest.raises(DeviceError, match="it supports"):
        camera.expose_for(2 * longest)
    assert camera.exposure_us == pytest.approx(4 * PERIOD_US, rel=1e-3)


def test_light_grows_with_the_exposure(opened: Rig, room: SimulatedRoom) -> None:
    stream = capture(opened, (White(), Black()), (PERIOD_US, 2 * PERIOD_US))
    frames = [frame for _, frame in stream.frames]
    assert [frame.exposure_us for frame in frames] == pytest.approx([PERIOD_US, 2 * PERIOD_US] * 2, rel=1e-3)
    short, long, dark, darker = (frame.image.astype(float) for frame in frames)
    lit = (long > 100) & (long < 250)
    assert np.median(long[lit] / short[lit]) == pytest.approx(2, abs=0.02)
    assert np.median(darker) < 0.2 * np.median(long[lit])
    assert np.median(dark) <= np.median(darker)


def test_a_scan_takes_each_pattern_at_each_exposure(config: Path, rig: Loopback, room: SimulatedRoom) -> None:
    code, folder = scan(config, "--set", f"sequence.exposures_us=[{PERIOD_US:.0f}, {2 * PERIOD_US:.0f}]")
    assert code == 0
    frames = open_capture(folder)
    assert len(frames.patterns) == 2 * 28
    full = room.sensor.full_well_electrons
    for index, (pattern, frame) in enumerate(frames.stream().frames):
        share = (0.5, 1.0)[index % 2]
        picture = pattern_image(pattern)
        expected = np.minimum(255, room.electrons(picture) * share * 255 / full)
        assert np.sqrt(np.mean((frame.image - expected) ** 2)) < 2.5, f"frame {index} is not of {pattern}"


def pattern_image(pattern: Pattern) -> Image:
    return draw(pattern, PROJECTOR)


def test_exposures_that_round_to_one_are_refused_before_the_first_frame(
    config: Path, rig: Loopback, capsys: pytest.CaptureFixture[str]
) -> None:
    code, folder = scan(config, "--set", "sequence.exposures_us=[16000, 18000]")
    assert code == 3
    message = capsys.readouterr().err
    assert "16000 and 18000 µs in exposures_us both" in message
    assert "further apart" in message
    assert not folder.exists()


def test_an_exposure_beyond_the_camera_is_refused(
    config: Path, rig: Loopback, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _ = scan(config, "--set", "sequence.exposures_us=[16667, 90000000]")
    assert code == 3
    assert "it supports" in capsys.readouterr().err


def test_the_best_exposure_is_found_from_a_dark_and_from_a_bright_start(
    config: Path, rig: Loopback, room: SimulatedRoom
) -> None:
    best = {}
    for start_us in (16_667, 100_000):
        config.write_text(CONFIG.replace("33333", str(start_us)))
        settings = load_config(config)
        with open_rig(settings.required_rig, CAMERA, PROJECTOR) as opened:
            proposal = propose_exposure(opened.rig)
        best[start_us] = proposal.exposure_us
        assert proposal.last.clipped <= 0.001
        assert 0.5 < proposal.last.brightest < 1
    assert list(best.values()) == pytest.approx([2 * PERIOD_US] * 2, rel=1e-3)
