"""The console's page through the real path: live image, exposure and gain, a scan, cancel."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hw.simulated import SimulatedRoom
from scanner.console import Activity, ConsoleSettings, IdlePicture, Worker
from scanner.io import read_calibration
from tests.support.loopback_bench import check_frames
from tests.support.notebook import Notebook
from tests.support.notebook import until as until_within

pytestmark = pytest.mark.xdist_group("loopback")

until = partial(until_within, patience_s=120)


@pytest.fixture
def page() -> Notebook:
    return Notebook()


@pytest.fixture
def worker(config: Path, rig: object, page: Notebook, monkeypatch: pytest.MonkeyPatch) -> Iterator[Worker]:
    monkeypatch.chdir(config.parent)
    worker = Worker(ConsoleSettings(config), page)
    worker.start()
    yield worker
    worker.close()


def brightness(page: Notebook) -> float:
    return float(np.mean(page.frames[-1].image)) if page.frames else 0.0


def test_the_live_image_shows_what_is_projected_and_follows_exposure_and_gain(worker: Worker, page: Notebook) -> None:
    assert worker.request(Activity.LIVE)
    until(lambda: page.frames)
    white = brightness(page)
    worker.change(picture=IdlePicture.BLACK)
    until(lambda: brightness(page) < white / 2)
    worker.change(picture=IdlePicture.WHITE, exposure_us=16_667.0)
    until(lambda: page.frames[-1].exposure_us == pytest.approx(16_667.0, rel=1e-3))
    until(lambda: 0.4 * white < brightness(page) < 0.7 * white)
    worker.change(gain=6.0)
    until(lambda: brightness(page) > 0.75 * white)
    worker.change(gain=0.0)  # the camera would keep it
    until(lambda: brightness(page) < 0.7 * white)


def test_a_scan_leaves_a_result(worker: Worker, page: Notebook, room: SimulatedRoom) -> None:
    assert worker.request(Activity.LIVE)
    until(lambda: page.frames)
    assert worker.request(Activity.SCANNING)
    until(lambda: page.results or worker.status.message)
    assert page.results, worker.status.message
    assert check_frames(page.results[0] / "capture", room) > 10
    found, truth = read_calibration(page.results[0] / "calibration.yaml"), room.calibration
    assert 0.9 < found.camera.focal_px[0] / truth.camera.focal_px[0] < 1.1


def test_a_cancelled_scan_keeps_complete_frames(
    worker: Worker, page: Notebook, config: Path, room: SimulatedRoom
) -> None:
    assert worker.request(Activity.SCANNING)
    until(lambda: len(page.frames) >= 4)
    worker.cancel()
    until(lambda: worker.status.message)
    (kept,) = config.parent.glob("**/*-incomplete")
    assert check_frames(kept / "capture", room) >= 3
