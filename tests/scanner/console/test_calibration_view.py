"""The console shows the calibration in use over time, and follows what is written into its log."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from scanner.results import log_of
from tests.support.browsing import Served, visiting
from tests.support.calibration_logs import write_logged
from tests.support.small_capture import CONFIG

pytestmark = pytest.mark.xdist_group("browser")


def test_the_calibration_over_time_follows_its_log(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "room.yaml").write_text(CONFIG)
    calibration = write_logged(tmp_path, 4)
    arguments = "console", "--config", "room.yaml", "--calibration", calibration.name
    with Served(tmp_path, *arguments) as served, visiting(browser, served.address) as visit:
        visit.press("History")
        visit.wait_for("The calibration over time")
        plots = visit.page.get_by_role("img", name="the calibration over time")
        expect(plots.locator("circle")).to_have_count(4 * 11)
        expect(visit.page.get_by_text("A change of the projector's focal length")).to_have_count(0)
        write_logged(tmp_path, 8)
        expect(plots.locator("circle")).to_have_count(8 * 11)
        visit.wait_for("✕ A change of the projector's focal length by 0.5 %")
        assert visit.small_texts() == []
        log_of(calibration).write_text("nothing")
        visit.wait_for("expected a list of calibrations over time")
        expect(plots).to_have_count(0)
        log_of(calibration).unlink()
        expect(visit.page.get_by_text("The calibration over time")).to_have_count(0)
        assert visit.complaints == []
