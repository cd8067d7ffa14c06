"""Names with HTML, quotes, Markdown, control characters and line ends, in a real browser and in the terminal.

They are those of the working folder, of the configuration, of results, and what a result's files say of it.
"""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from playwright.sync_api import Browser, Page, expect

from calib.finding import Severity
from scanner.commands import main
from scanner.comparing import COMPARE_PAGE
from scanner.results import LOG_FILE
from scanner.viewing import escaped
from tests.support.browsing import Served, Visit, visiting
from tests.support.hostile import FILE_NAME, TEXT, assert_harmless
from tests.support.result_folder import write_result
from tests.support.small_capture import CONFIG

pytestmark = pytest.mark.xdist_group("browser")


def write_hostile(folder: Path) -> None:
    """A result whose files say hostile things of it."""
    write_result(folder)
    file = folder / "calibration.yaml"
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    content["verdict"] = {"grade": "fair", "headline": TEXT, "reasons": [TEXT] * 9, "advice": TEXT}
    finding = {"kind": TEXT, "severity": Severity.WARNING.value, "message": TEXT, "advice": TEXT}
    content["findings"] = [finding]
    file.write_text(yaml.safe_dump(content, allow_unicode=True), encoding="utf-8")
    (folder / LOG_FILE).write_text(TEXT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder with two results, all with hostile names."""
    folder = tmp_path_factory.mktemp("hostile") / FILE_NAME
    for number in (1, 2):
        write_hostile(folder / "scans" / f"{number}{FILE_NAME}")
        (folder / "scans" / f"{number}{FILE_NAME}" / "note.txt").write_text(TEXT, encoding="utf-8")
    (folder / f"{FILE_NAME}.yaml").write_text(CONFIG)
    return folder


def results(folder: Path) -> list[Path]:
    return sorted((folder / "scans").iterdir())


@pytest.fixture
def harmless(browser: Browser) -> Iterator[Page]:
    page = browser.new_page()
    yield page
    page.close()


def assert_shown_as_text(served: Served, visit: Visit) -> None:
    """The page ran and fetched nothing, and the terminal got no control characters."""
    assert_harmless(visit.page)
    assert visit.foreign == []
    code, output = served.interrupt()
    assert code == 130
    assert "\x1b" not in served.first_line + output


def test_a_result_is_shown_as_text(folder: Path, browser: Browser) -> None:
    with Served(folder, "view", results(folder)[0]) as served, visiting(browser, served.address) as visit:
        visit.wait_for("Points, %")
        visit.wait_for("<img src=x onerror=")
        assert_shown_as_text(served, visit)


def test_the_console_shows_names_as_text(folder: Path, browser: Browser) -> None:
    config = next(folder.glob("*.yaml"))
    with Served(folder, "console", "--config", config) as served, visiting(browser, served.address) as visit:
        visit.wait_for("Exposed for")
        visit.press("History")
        visit.wait_for("<img src=x onerror=")
        expect(visit.page.locator(".scan-note")).to_have_count(2)
        visit.page.get_by_text("Rename, note, delete").click()
        note = visit.page.locator("textarea:visible").first
        expect(note).to_have_value(re.compile(r"<script>window\.taken = 1<!--$"))
        note.fill(f"{TEXT}\N{RIGHT-TO-LEFT OVERRIDE}")
        visit.press("Save the note")
        visit.wait_for("The note is saved.")
        visit.press("Delete")
        visit.wait_for("is in the bin")
        visit.page.get_by_role("button", name="Undo delete of").click()
        visit.wait_for("is back.")
        visit.page.get_by_role("button", name="Open 1").click()
        visit.wait_for("Points, %")
        assert_shown_as_text(served, visit)


def test_live_clouds_show_names_as_text(folder: Path, browser: Browser) -> None:
    """Of the working folder, the configuration, the calibration, and the result that is kept."""
    config = next(folder.glob("*.yaml"))
    with contextlib.chdir(folder):
        assert main(["--config", str(config), "--out", f"rig{FILE_NAME}", "--quiet"]) == 0
    calibration, out = f"rig{FILE_NAME}/calibration.yaml", f"live{FILE_NAME}"
    live = ("live", "--page", "--config", config, "--calibration", calibration, "--out", out)
    with Served(folder, *live) as served, visiting(browser, served.address) as visit:
        visit.wait_for("clouds a second")
        visit.press("Keep this cloud")
        visit.wait_for("Station 1 is kept: ")
        assert_shown_as_text(served, visit)
    assert (folder / out / "captures" / "1" / "cloud.ply").is_file()


def test_a_comparison_shows_names_as_text(
    folder: Path, harmless: Page, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    first, second = results(folder)
    assert main(["compare", str(first), str(second), "--out", str(tmp_path / "out")]) == 0
    harmless.goto((tmp_path / "out" / COMPARE_PAGE).as_uri())
    expect(harmless.get_by_text("<img src=x onerror=").first).to_be_visible()
    assert_harmless(harmless)
    assert "\x1b" not in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    "arguments", [["measure"], ["export", "--to", "ply"], ["replay"], ["object"], ["room"], ["network"], ["view"]]
)
def test_the_terminal_shows_no_control_characters(
    folder: Path, arguments: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    command, *options = arguments
    place = results(folder)[0]
    if command == "view":
        place = place / "nowhere"
    code = main([command, str(place), *options, *(["--out", str(tmp_path / "out")] if command != "view" else [])])
    screen = "".join(capsys.readouterr())
    assert code in (0, 2)
    assert screen
    assert "\x1b[31m" not in screen
    assert "Traceback" not in screen


def test_everything_that_markdown_reads_is_escaped() -> None:
    letters = np.array([*"\\`*_{}[]<>#|$~"])
    assert escaped("".join(letters)) == "".join(f"\\{letter}" for letter in letters)
