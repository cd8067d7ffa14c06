"""Films of a simulated room become captures that decode as well as single frames."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from filming import Camera

from scanner.acquisition import decode_recording
from scanner.capture import open_capture
from scanner.decoding import Decoder
from scanner.patterns import PresetName
from scanner.ui import Terminal
from tests.support.command_line import run
from tests.support.room import BIT_RATE, CAMERA, PROJECTOR, FilmedRoom

pytestmark = pytest.mark.xdist_group("recordings")


def imported(filmed: FilmedRoom, recording: Path, out: Path) -> dict[str, Any]:
    """The parameters estimated from a recording."""
    assert run("import", recording, "--sequence", filmed.sequence, "--out", out, "--quiet") == 0
    found: dict[str, Any] = yaml.safe_load((out / "capture.yaml").read_text(encoding="utf-8"))["recording"]
    return found


def median_error_px(filmed: FilmedRoom, capture: Path) -> float:
    recording = open_capture(capture)
    assert (recording.camera_size, recording.projector_size) == (CAMERA, PROJECTOR)
    decoder = Decoder(recording.patterns, recording.projector_size)
    for _, frame in recording.stream().frames:
        decoder.add(frame.image)
    matches = decoder.finish().matches
    x, y = np.rint(matches.camera_px).astype(int).T
    error = np.linalg.norm(matches.projector_px - filmed.room.ground_truth().projector_px[y, x], axis=1)
    assert len(matches) > 0.5 * np.count_nonzero(np.isfinite(filmed.room.ground_truth().projector_px[..., 0]))
    return float(np.nanmedian(error))


def test_the_clock_of_a_phone_is_estimated_and_its_film_decodes(
    filmed: FilmedRoom, recording: Path, tmp_path: Path
) -> None:
    found = imported(filmed, recording, tmp_path / "capture")
    # The projector's answer adds 2 ms to the exposure of 16.7, and its scanning out takes 8 off the readout of 20.
    assert 15 < found["exposure_ms"] < 21
    assert 9 < found["readout_ms"] < 15
    assert -1400 < found["projector_slower_ppm"] < -600
    assert 2.0 < found["tone_exponent"] < 2.6
    assert 0.01 < median_error_px(filmed, tmp_path / "capture") < 0.12
    frames = yaml.safe_load((tmp_path / "capture" / "capture.yaml").read_text(encoding="utf-8"))["frames"]
    assert 1e-4 < found["smooth_px"] < 5e-3
    assert all(3 <= frame["averaged"] <= 6 and frame["alone"] == 1 and 1e-4 < frame["noise"] < 0.02 for frame in frames)


def test_a_film_at_the_rate_of_television(tmp_path: Path) -> None:
    """A change wraps once round the frame, and half the exposure would fit all others."""
    filmed = FilmedRoom(tmp_path, hold_s=0.2)
    camera = Camera(rate=60_000 / 1001, exposure_s=0.01, readout_s=0.012, fast=9e-6, bit_rate=2 * BIT_RATE)
    found = imported(filmed, filmed.film("television.mp4", camera), tmp_path / "capture")
    # As above, 2 ms of answer and 8 ms of scanning out.
    assert 10 < found["exposure_ms"] < 13
    assert 2.5 < found["readout_ms"] < 5.5
    assert -150 < found["projector_slower_ppm"] < 100
    assert not found["findings"]
    assert 0.005 < median_error_px(filmed, tmp_path / "capture") < 0.12


@pytest.mark.parametrize("preset", ["quick", "standard"])
def test_errors_of_a_film_are_as_large_as_its_sigmas(
    preset: PresetName, filmed: FilmedRoom, recording: Path, tmp_path: Path
) -> None:
    """An encoder's errors are not all among what shows the same light twice; neighbouring coordinates have them."""
    if preset != filmed.preset:
        filmed = FilmedRoom(tmp_path, preset=preset)
        recording = filmed.film("film.mp4", Camera(bit_rate=BIT_RATE))
    imported(filmed, recording, tmp_path / "capture")
    matches = decode_recording(open_capture(tmp_path / "capture"), Terminal(quiet=True)).matches
    assert matches.sigma_px is not None
    x, y = np.rint(matches.camera_px).astype(int).T
    relative = (matches.projector_px - filmed.room.ground_truth().projector_px[y, x]) / matches.sigma_px[:, None]
    relative = relative[(np.abs(relative) < 10).all(axis=1)]
    assert len(relative) > 0.95 * len(matches)
    assert np.all(np.sqrt(np.mean(relative**2, axis=0)) > 0.8)
    assert np.all(np.sqrt(np.mean(relative**2, axis=0)) < 1.25)


def test_a_film_in_ten_bits_with_repeated_frames(filmed: FilmedRoom, tmp_path: Path) -> None:
    camera = Camera(
        rate=25, exposure_s=1 / 200, ten_bit=True, bit_rate=BIT_RATE, tone="filmic", repeated=(100, 101, 151)
    )
    found = imported(filmed, filmed.film("fast.mov", camera), tmp_path / "capture")
    assert 24.9 < found["frames_per_second"] < 25.1
    assert 0.005 < median_error_px(filmed, tmp_path / "capture") < 0.12


def test_a_moving_camera_that_changes_its_exposure_is_reported(filmed: FilmedRoom, tmp_path: Path) -> None:
    unsteady = Camera(
        bit_rate=BIT_RATE, gain=lambda time_s: 1 - 0.024 * time_s, motion=lambda time_s: (0.15 * time_s, 0.0, 0.0)
    )
    found = imported(filmed, filmed.film("unsteady.mp4", unsteady), tmp_path / "capture")
    findings = {finding["kind"]: finding for finding in found["findings"]}
    assert 0.3 < findings["picture-moved"]["data"]["moved_px"] < 2
    assert 0.1 < findings["exposure-changed"]["data"]["exposure_share"] < 0.2


def test_a_film_without_its_end_is_reported(
    filmed: FilmedRoom, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = filmed.film("short.mp4", Camera(bit_rate=BIT_RATE), length_s=5.0)
    assert run("import", short, "--sequence", filmed.sequence, "--out", tmp_path / "capture") == 2
    assert "one start mark was filmed" in capsys.readouterr().err
    assert not (tmp_path / "capture").exists()
