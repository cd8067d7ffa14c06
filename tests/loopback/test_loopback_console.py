"""What the console's page does, through the real path: live image, exposure and gain, a scan, cancel."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from loopback_bench import check_frames

from hw.rig import Frame
from scanner.calibration_file import read_calibration
from scanner.console.settings import Picture, Settings
from scanner.console.worker import Activity, Status, Worker

pytestmark = pytest.mark.xdist_group("loopback")


class Page:
    """Writes down frames and results."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.results: list[Path] = []

    def on_status(self, status: Status) -> None: ...

    def on_camera(self, rig: object) -> None: ...

    def on_frame(self, frame: Frame) -> None:
        self.frames.append(frame)

    def on_row(self, row: object) -> None: ...

    def on_report(self, report: object) -> None: ...

    def on_result(self, folder: Path) -> None:
        self.results.append(folder)


@pytest.fixture
def page() -> Page:
    return Page()


@pytest.fixture
def worker(config: Path, rig: object, page: Page, monkeypatch: pytest.MonkeyPatch) -> Iterator[Worker]:
    monkeypatch.chdir(config.parent)
    worker = Worker(Settings(config), page)
    worker.start()
    yield worker
    worker.close()


def until(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline_s, "it did not come to pass"
        time.sleep(0.01)


def brightness(page: Page) -> float:
    return float(np.mean(page.frames[-1].image)) if page.frames else 0.0


def test_the_live_image_shows_what_is_projected_and_follows_exposure_and_gain(worker: Worker, page: Page) -> None:
    assert worker.request(Activity.LIVE)
    until(lambda: page.frames)
    white = brightness(page)
    worker.change(picture=Picture.BLACK)
    until(lambda: brightness(page) < white / 2)
    worker.change(picture=Picture.WHITE, exposure_us=16_667.0)
    until(lambda: page.frames[-1].exposure_us == pytest.approx(16_667.0, rel=1e-3))
    until(lambda: 0.4 * white < brightness(page) < 0.7 * white)
    worker.change(gain=6.0)
    until(lambda: brightness(page) > 0.75 * white)
    worker.change(gain=0.0)  # the camera would keep it
    until(lambda: brightness(page) < 0.7 * white)


def test_a_scan_leaves_a_result(worker: Worker, page: Page, room) -> None:
    assert worker.request(Activity.LIVE)
    until(lambda: page.frames)
    assert worker.request(Activity.SCANNING)
    until(lambda: page.results or worker.status.message)
    assert page.results, worker.status.message
    assert check_frames(page.results[0] / "capture", room) > 10
    found, truth = read_calibration(page.results[0] / "calibration.yaml"), room.calibration
    assert 0.9 < found.camera.focal_px[0] / truth.camera.focal_px[0] < 1.1


def test_a_scan_that_is_cancelled_keeps_whole_frames(worker: Worker, page: Page, config: Path, room) -> None:
    assert worker.request(Activity.SCANNING)
    until(lambda: len(page.frames) >= 4)
    worker.cancel()
    until(lambda: worker.status.message)
    (kept,) = config.parent.glob("**/*-incomplete")
    assert check_frames(kept / "capture", room) >= 3
