"""The worker that owns the rig, without a browser."""

import base64
import threading
import time
import wave
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from hw.errors import DeviceError, FrameLostError
from hw.open_rig import OpenedRig
from hw.rig import Capabilities, Frame, Rig
from scanner import acquisition
from scanner.console import worker as worker_module
from scanner.console.operating import chime
from scanner.console.progress import CancelledError, ProgressStep, StagedProgress, durations_in
from scanner.console.settings import ConsoleSettings, IdlePicture, plain_name
from scanner.console.worker import Activity, Status, Worker
from scanner.networks import OnSight, Pair, Watched
from scanner.patterns import White
from scanner.results import read_verdict
from scanner.ui import Operator, Progress
from tests.support.notebook import Notebook, until

SIZE = (32, 24)
CONFIG = "rig: {backend: simulated}\ncamera: {width: 32, height: 24}\nprojector: {width: 32, height: 24}\n"


class Wall:
    """A projector, and a camera that sees a share of its light, until `fails_after` frames were taken."""

    size = SIZE
    highest_level = 255
    capabilities = Capabilities(exposure="settable")
    exposure_limits_us = (10.0, 1e6)

    def __init__(self) -> None:
        self.exposure_us = 10_000.0
        self.taken = 0
        self.fails_after = 10**9
        self.image = np.zeros(SIZE[::-1], np.uint8)
        self.loses = 0
        self.open = 0
        self.opened = 0

    def show(self, image: np.ndarray) -> None:
        self.image = image

    def expose_for(self, exposure_us: float) -> float:
        self.exposure_us = exposure_us
        return exposure_us

    def grab(self) -> Frame:
        if self.loses:
            self.loses -= 1
            raise FrameLostError("incomplete: size mismatch")
        if self.taken >= self.fails_after:
            raise DeviceError("camera: it went away. Check the cable.")
        self.taken += 1
        time.sleep(0.01)
        return Frame(self.image // 2, exposure_us=self.exposure_us)

    @contextmanager
    def rig(self, *_: object) -> Iterator[Rig]:
        self.open += 1
        self.opened += 1
        assert self.open == 1, "the rig is open twice"
        try:
            yield Rig(self, self)
        finally:
            self.open -= 1


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    wall = Wall()

    @contextmanager
    def open_rig(*_: object) -> Iterator[OpenedRig]:
        with wall.rig() as rig:
            yield OpenedRig(rig, None)

    monkeypatch.setattr(worker_module, "opened", wall.rig)
    monkeypatch.setattr(acquisition, "open_rig", open_rig)
    return wall


@pytest.fixture
def page() -> Notebook:
    return Notebook()


@pytest.fixture
def worker(wall: Wall, page: Notebook, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Worker]:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wall.yaml").write_text(CONFIG)
    worker = Worker(ConsoleSettings(Path("wall.yaml")), page)
    worker.start()
    yield worker
    worker.close()
    assert wall.open == 0


def test_the_live_image_follows_the_settings_on_one_open_rig(worker: Worker, page: Notebook, wall: Wall) -> None:
    assert worker.request(Activity.LIVE)
    until(lambda: page.frames)
    assert page.frames[-1].image.max() == 127
    worker.change(exposure_us=20_000.0, picture=IdlePicture.BLACK)
    until(lambda: page.frames[-1].exposure_us == 20_000.0)
    until(lambda: page.frames[-1].image.max() == 0)
    assert wall.opened == 1
    assert worker.status.activity is Activity.LIVE


def test_a_new_gain_reopens_the_rig(worker: Worker, page: Notebook, wall: Wall, tmp_path: Path) -> None:
    (tmp_path / "wall.yaml").write_text(CONFIG.replace("simulated", "aravis"))
    worker.request(Activity.LIVE)
    until(lambda: page.frames)
    worker.change(gain=3.0)
    until(lambda: wall.opened == 2 and wall.open == 1)


def test_the_live_image_stops_on_request(worker: Worker, page: Notebook, wall: Wall) -> None:
    worker.request(Activity.LIVE)
    until(lambda: page.frames)
    assert worker.request(Activity.NOTHING)
    until(lambda: worker.status == Status())
    until(lambda: wall.open == 0)


def test_a_device_failure_gives_a_message(worker: Worker, page: Notebook, wall: Wall) -> None:
    wall.fails_after = 3
    worker.request(Activity.LIVE)
    until(lambda: worker.status.message)
    assert worker.status == Status(message="camera: it went away. Check the cable.")
    assert len(page.frames) == 3
    wall.fails_after = 10**9
    assert worker.request(Activity.LIVE)  # and it can be tried again
    until(lambda: len(page.frames) > 3)


def test_a_scan_that_is_cancelled_keeps_its_frames(worker: Worker, page: Notebook, wall: Wall, tmp_path: Path) -> None:
    worker.request(Activity.LIVE)
    until(lambda: page.frames)
    shown = len(page.frames)
    assert worker.request(Activity.SCANNING)
    until(lambda: worker.status.stage and worker.status.stage.done >= 2)
    assert not worker.request(Activity.LIVE), "the rig is busy"
    worker.cancel()
    until(lambda: worker.status.message)
    assert worker.status.message.startswith("Cancelled.\nThe ")
    assert "frames captured so far are in scans/wall-incomplete/capture" in worker.status.message
    frames = list((tmp_path / "scans/wall-incomplete/capture/frames").iterdir())
    assert 2 <= len(frames) < 44
    assert len(page.frames) > shown, "the page shows what is captured"
    assert page.results == []
    assert any(status.cancelling for status in page.statuses)


def test_a_refused_scan_gives_the_reason_and_the_path_of_the_matches(
    worker: Worker, page: Notebook, tmp_path: Path
) -> None:
    worker.request(Activity.SCANNING)
    until(lambda: worker.status.message)
    assert worker.status.message.startswith("no trustworthy calibration: ")
    assert "The matches and a report are in scans/wall." in worker.status.message
    assert (tmp_path / "scans/wall/report.html").is_file()
    assert page.results == [Path("scans/wall")]
    told = read_verdict(tmp_path / "scans/wall/refused.yaml")
    assert told is not None
    assert told.grade == "refused"
    assert told.reasons[0] in worker.status.message


def test_lost_frames_are_skipped_and_counted(worker: Worker, page: Notebook, wall: Wall) -> None:
    worker.request(Activity.LIVE)
    until(lambda: page.frames)
    wall.loses = 3
    until(lambda: wall.loses == 0)
    shown = len(page.frames)
    until(lambda: len(page.frames) > shown)
    told = [status.stage.what for status in page.statuses if status.stage]
    assert "What the camera sees (3 frames were lost; the last: incomplete: size mismatch)" in told
    assert worker.status.activity is Activity.LIVE
    assert wall.opened == 1


def test_a_scan_gets_the_typed_name(worker: Worker, page: Notebook, tmp_path: Path) -> None:
    worker.change(name=plain_name(" north wall/../2 "))
    for number, expected in enumerate(("north-wall-..-2", "north-wall-..-2-2"), start=1):
        until(lambda: worker.request(Activity.SCANNING))
        while len(page.results) < number:
            time.sleep(0.01)
        assert page.results[-1] == Path("scans", expected)


def test_a_bug_gives_a_message_with_a_file(worker: Worker, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(worker_module, "scan", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    worker.request(Activity.SCANNING)
    until(lambda: worker.status.message)
    assert "a bug in this program: ZeroDivisionError" in worker.status.message
    assert "Traceback" not in worker.status.message
    (log,) = tmp_path.glob("scan-*.log")
    assert "Traceback" in log.read_text()


def test_between_captures_the_operator_is_asked(worker: Worker, page: Notebook, wall: Wall, tmp_path: Path) -> None:
    (tmp_path / "wall.yaml").write_text(CONFIG.replace("simulated", "aravis"))
    worker.change(captures=3)
    worker.request(Activity.SCANNING)
    until(lambda: worker.status.question)
    assert "Capture 1 of 3 is done. Move the rig as a whole" in worker.status.question
    assert worker.status.guidance[0].startswith("Not enough to calibrate yet: ")
    assert page.captured == 1
    worker.answer(more=True)
    until(lambda: "Capture 2 of 3" in worker.status.question)
    worker.answer(more=False)
    until(lambda: worker.status.message)
    assert worker.status.message.startswith("no trustworthy calibration: ")
    assert [path.name for path in (tmp_path / "scans/wall/captures").iterdir()] == ["1"]
    assert page.captured == 2


def test_a_question_ends_with_the_scan(worker: Worker, wall: Wall, tmp_path: Path) -> None:
    (tmp_path / "wall.yaml").write_text(CONFIG.replace("simulated", "aravis"))
    worker.change(captures=2)
    worker.request(Activity.SCANNING)
    until(lambda: worker.status.question)
    worker.cancel()
    until(lambda: worker.status.message)
    assert worker.status.message.startswith("Cancelled.")
    assert (tmp_path / "scans/wall-incomplete/capture").is_dir()


def test_closing_cancels_and_reports_the_outcome(worker: Worker, tmp_path: Path) -> None:
    worker.request(Activity.SCANNING)
    until(lambda: worker.status.stage and worker.status.stage.done >= 2)
    assert "scans/wall-incomplete/capture" in worker.close().message


NETWORK = f"{CONFIG}rigs: {{cameras: {{left: {{}}, right: {{}}}}, projectors: {{stage: {{}}}}}}\n"


def test_a_device_of_a_network_that_fails_is_named_in_the_message_and_on_the_page(
    worker: Worker, page: Notebook, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(
        pairs: Iterable[Pair],
        _stations: int,
        _folder: Path,
        _operator: Operator,
        progress: Progress,
        on_sight: OnSight,
    ) -> None:
        last = [*pairs][-1]
        with Watched([last], progress, on_sight) as watched:
            for _ in watched.track(((White(), Frame(np.zeros((2, 2), np.uint8))),) * 3, 4, "Capturing"):
                pass
            raise DeviceError("camera: it went away. Check the cable.")

    monkeypatch.setattr("scanner.networks.job.take_stations", failing)
    (tmp_path / "wall.yaml").write_text(NETWORK)
    worker.request(Activity.NETWORK)
    until(lambda: worker.status.message)
    assert worker.status.message.splitlines() == [
        "camera: it went away. Check the cable.",
        "This was right in the light of stage.",
    ]
    assert [sight.text for sight in page.sights] == [
        *("1 of 4 frames", "2 of 4 frames", "3 of 4 frames"),
        "failed: camera: it went away. Check the cable.",
    ]
    stages = [status.stage for status in page.statuses if status.stage]
    assert ProgressStep("right in the light of stage", 3, 4) in stages
    assert page.results == []


def test_live_view_cycles_through_the_cameras_of_a_network_until_one_is_chosen(
    worker: Worker, page: Notebook, wall: Wall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_module, "_TURN_S", 0.1)
    (tmp_path / "wall.yaml").write_text(NETWORK)
    worker.request(Activity.LIVE)
    until(lambda: {*page.cameras} == {"left", "right"})
    worker.change(pair=("right", "stage"))
    until(lambda: page.cameras[-3:] == ["right"] * 3)
    opened = wall.opened
    worker.change(exposure_us=30_000.0)
    until(lambda: page.frames[-1].exposure_us == 30_000.0)
    assert wall.opened == opened
    wall.fails_after = wall.taken
    until(lambda: worker.status.message)
    assert worker.status.message.splitlines()[1:] == ["This was right with stage."]


@pytest.mark.parametrize(
    ("config", "distance", "activity", "message"),
    [
        (CONFIG, "", Activity.NETWORK, "the configuration has no 'rigs': name a network's devices, as in rigs: {"),
        (NETWORK, "lefft,stage,2m", Activity.NETWORK, "no device is called 'lefft'; there are left, right, stage"),
        (NETWORK, "left,stage", Activity.NETWORK, "expected two devices and a length"),
        (NETWORK, "", Activity.SCANNING, "wall.yaml names several devices: choose a camera and a projector"),
        (NETWORK.replace("right: {}", "right: {rig: {poze: 1}}"), "", Activity.NETWORK, "did you mean 'rig.pose'?"),
    ],
)
def test_unusable_network_settings_are_refused_before_devices_are_opened(
    config: str, distance: str, activity: Activity, message: str, worker: Worker, wall: Wall, tmp_path: Path
) -> None:
    (tmp_path / "wall.yaml").write_text(config)
    worker.change(distance=distance)
    worker.request(activity)
    until(lambda: worker.status.message)
    assert message in worker.status.message
    assert wall.opened == 0


def test_requests_come_one_at_a_time(worker: Worker, page: Notebook) -> None:
    worker.request(Activity.SCANNING)
    until(lambda: worker.status.activity is Activity.SCANNING)
    answers: list[bool] = []
    threads = [threading.Thread(target=lambda: answers.append(worker.request(Activity.SCANNING))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [False] * 8


def test_progress_shows_frames_and_stops_between_them() -> None:
    cancelled = threading.Event()
    stages: list[object] = []
    frames: list[object] = []
    progress = StagedProgress(cancelled, stages.append, frames.append)
    frame = Frame(np.zeros((2, 2), np.uint8))
    taken = progress.track([("pattern", frame), ("pattern", frame), ("pattern", frame)], 3, "Capturing")
    assert next(taken)
    assert next(taken)
    cancelled.set()
    with pytest.raises(CancelledError):
        next(taken)
    assert stages == [ProgressStep("Capturing", 0, 3), ProgressStep("Capturing", 1, 3)]
    assert frames == [frame, frame]
    with pytest.raises(CancelledError), progress.step("Calibrating"):
        pytest.fail("a step began after it was cancelled")


def test_the_remaining_time_is_estimated_from_the_last_run(tmp_path: Path) -> None:
    log = tmp_path / "scan.log"
    log.write_text(
        "2026-01-02 03:04:05,100 INFO scanner.ui.terminal: Capturing and decoding: 23\n"
        "2026-01-02 03:04:09,000 INFO scanner.decoding: something else\n"
        "2026-01-02 03:04:15,100 INFO scanner.console.progress: Calibrating\n"
        "2026-01-02 03:04:22,100 INFO scanner.ui.terminal: Writing the result\n"
    )
    assert durations_in(log) == {"Capturing and decoding": pytest.approx(10, abs=1), "Calibrating": 7}
    assert durations_in(tmp_path / "nothing") == {}
    log.write_text(log.read_text().replace("03:04:22,", "03:04:22+05,"))
    assert durations_in(log)["Calibrating"] == 7, "a damaged line"
    assert ProgressStep("Calibrating", began_s=100.0, usual_s=7.0).left_s(102.0) == 5.0
    assert ProgressStep("Calibrating", began_s=100.0, usual_s=7.0).left_s(120.0) is None
    assert ProgressStep("Capturing", 5, 20, began_s=100.0, usual_s=1.0).left_s(110.0) == 30.0
    assert ProgressStep("Calibrating", began_s=100.0).left_s(110.0) is None


def test_the_sound_is_valid() -> None:
    with wave.open(BytesIO(base64.b64decode(chime().partition(",")[2]))) as sound:
        samples = np.frombuffer(sound.readframes(sound.getnframes()), "<i2")
        assert 0.2 < sound.getnframes() / sound.getframerate() < 0.5
    assert 3000 < np.abs(samples).max() < 20_000


def test_a_stage_in_per_cent() -> None:
    assert ProgressStep("x", 5, 20).percent == 25
    assert ProgressStep("x").percent == 0
