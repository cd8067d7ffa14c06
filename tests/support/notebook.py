"""A page without a browser, for tests of the console's worker."""

import time
from collections.abc import Callable
from pathlib import Path

from hw.rig import Frame, Rig
from scanner.checking import CheckReport, CheckRow
from scanner.console import Status
from scanner.live import Watcher
from scanner.networks import PairProgress
from scanner.results import Scan


class Notebook:
    """A page that records its updates."""

    def __init__(self) -> None:
        self.statuses: list[Status] = []
        self.frames: list[Frame] = []
        self.cameras: list[str] = []
        self.sights: list[PairProgress] = []
        self.rigs: list[Rig] = []
        self.clouds: list[Scan] = []
        self.results: list[Path] = []
        self.captured = 0

    def on_status(self, status: Status) -> None:
        self.statuses.append(status)

    def on_camera(self, rig: Rig) -> None:
        self.rigs.append(rig)

    def on_frame(self, frame: Frame, camera: str = "") -> None:
        self.frames.append(frame)
        self.cameras.append(camera)

    def on_sight(self, sight: PairProgress, frame: Frame | None) -> None:
        self.sights.append(sight)

    def on_captured(self) -> None:
        self.captured += 1

    def on_row(self, row: CheckRow) -> None: ...

    def on_report(self, report: CheckReport) -> None: ...

    def on_cloud(self, scan: Scan) -> None:
        self.clouds.append(scan)

    def on_result(self, folder: Path) -> None:
        self.results.append(folder)

    def live_watcher(self) -> Watcher:
        return Watcher()


def until(condition: Callable[[], object], patience_s: float = 30) -> None:
    deadline_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline_s, "it did not come to pass"
        time.sleep(0.005)
