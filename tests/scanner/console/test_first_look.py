"""The preview of the cloud before the result is saved."""

from pathlib import Path

import numpy as np
import pytest

from scanner import load_config, scan
from scanner.console.settings import ConsoleSettings
from scanner.console.worker import Activity, Worker
from scanner.io import read_cloud
from scanner.results import CLOUD_FILE, Scan
from scanner.viewing import ViewedCloud, preview_scan
from scanner.viewing import first_look as module
from tests.support.notebook import Notebook, until
from tests.support.small_capture import CONFIG


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    return path


def test_the_preview_is_a_part_of_the_saved_cloud(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DEFAULT_SHOWN", 5000)
    looks: list[tuple[ViewedCloud, int, bool]] = []

    def look(found: Scan) -> None:
        looks.append((*preview_scan(found), Path("result").exists()))

    scan(load_config(config), Path("result"), on_cloud=look)
    ((some, count, exists),) = looks
    saved = read_cloud(Path("result", CLOUD_FILE))
    assert not exists
    assert len(some.points) == 5000 < count == len(saved)
    rows = {tuple(point): number for number, point in enumerate(saved.points.tolist())}
    own = [rows[tuple(point)] for point in some.points.tolist()]
    np.testing.assert_array_equal(some.colours, saved.colours[own])
    np.testing.assert_array_equal(some.normals, saved.normals[own])
    assert np.std(np.diff(own)) > 0.5 * np.mean(np.diff(own))  # no stripes
    (rig,) = some.rigs
    assert some.unit == rig.calibration.unit


def test_the_page_gets_the_preview_once_and_before_the_result(config: Path) -> None:
    class Broken(Notebook):
        """A page that shows results, but fails on previews."""

        def on_cloud(self, scan: Scan) -> None:
            assert not self.results
            super().on_cloud(scan)
            raise ZeroDivisionError

    page = Broken()
    worker = Worker(ConsoleSettings(config), page)
    worker.start()
    worker.request(Activity.SCANNING)
    until(lambda: page.results, patience_s=120)
    until(lambda: not worker.status.busy)
    worker.close()
    assert len(page.clouds) == 1
    assert worker.status.message == ""
    assert (page.results[0] / CLOUD_FILE).is_file()
