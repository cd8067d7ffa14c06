"""Live clouds in a real browser: on their own page, and in the console."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from hw.open_rig import open_rig
from scanner.configuration import load_config
from scanner.io import read_matches, write_calibration
from tests.support.browsing import PATIENCE_MS, Served, Visit, visiting
from tests.support.notebook import until
from tests.support.small_capture import CONFIG

pytestmark = pytest.mark.xdist_group("browser")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With a room.yaml, and its rig's true calibration."""
    (tmp_path / "room.yaml").write_text(CONFIG)
    config = load_config(tmp_path / "room.yaml")
    with open_rig(config.required_rig, config.camera_size, config.projector_size) as opened:
        assert opened.truth is not None
        write_calibration(tmp_path / "true.yaml", opened.truth)
    return tmp_path


@pytest.fixture
def live(folder: Path) -> Iterator[Served]:
    with Served(folder, "live", "--config", "room.yaml", "--calibration", "true.yaml", "--page") as served:
        yield served


def test_the_newest_cloud_is_shown_and_kept(browser: Browser, folder: Path, live: Served) -> None:
    with visiting(browser, live.address) as visit:
        visit.wait_for("clouds a second")
        grey = _sees_a_cloud(visit)
        visit.choose("Colour", "Uncertainty of depth")
        expect(visit.page.locator(".scan-bar")).to_be_visible(timeout=PATIENCE_MS)
        until(lambda: visit.colours_in_scene() != grey, PATIENCE_MS / 1000)
        visit.press("Keep this cloud")
        visit.wait_for("Station 1 is kept: ")
    code, said = live.interrupt()
    assert code == 130
    assert "Result: scans/room-live (1 station in captures)" in said
    assert len(read_matches(folder / "scans/room-live/captures/1/matches.npz")) > 5000


def test_the_console_shows_live_clouds_and_cancel_ends_them(browser: Browser, folder: Path) -> None:
    with (
        Served(folder, "console", "--config", "room.yaml", "--calibration", "true.yaml") as served,
        visiting(browser, served.address) as visit,
    ):
        visit.wait_for("Exposed for")
        visit.press("Live clouds")
        visit.wait_for("clouds a second")
        _sees_a_cloud(visit)
        visit.press("Keep this cloud")
        visit.wait_for("Station 1 is kept: ")
        visit.press("Cancel")
        visit.wait_for("Result: scans/room-live (1 station in captures)")
        assert (folder / "scans/room-live/captures/1/matches.npz").is_file()
        # With nothing kept nothing is left.
        visit.press("Live clouds")
        visit.wait_for("clouds a second")
        visit.press("Cancel")
        expect(visit.page.get_by_role("button", name="Scan", exact=True)).to_be_visible(timeout=PATIENCE_MS)
        assert not list(folder.glob("scans/*live-2*"))


def _sees_a_cloud(visit: Visit) -> int:
    """Returns the number of colours that it has: greys, for the devices are not in the middle."""
    expect(visit.page.get_by_role("img", name="scale bar: ")).to_be_visible(timeout=PATIENCE_MS)
    seen = [0]

    def is_there() -> bool:
        seen[0] = visit.colours_in_scene()
        return seen[0] > 5

    until(is_there, PATIENCE_MS / 1000)
    return seen[0]
