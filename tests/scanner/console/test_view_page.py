"""`scan view` in a real browser, on a result with ground truth."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, expect

from calib.geometry import Intrinsics
from scanner.cleaning import read_cleaned
from scanner.commands import main
from scanner.io import read_cloud
from scanner.results import read_steps
from tests.support.browsing import Served, Visit, visiting
from tests.support.result_folder import write_captures

pytestmark = pytest.mark.xdist_group("browser")

SMALL = Intrinsics(204, 171, (149.5, 149.5), (104.5, 88.0), (-0.05, 0.0, 0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    write_captures(folder / "room", SMALL)
    (folder / "room" / "report.html").write_text("A report's own words", encoding="utf-8")
    return folder / "room"


@pytest.fixture(scope="module")
def served(room: Path) -> Iterator[Served]:
    with Served(room.parent, "view", room) as served:
        yield served


@pytest.fixture(scope="module")
def visit(served: Served, browser: Browser) -> Iterator[Visit]:
    with visiting(browser, served.address) as visit:
        visit.wait_for("Points, %")
        yield visit


def test_the_page_shows_everything_about_the_result(visit: Visit) -> None:
    for text in (
        "Angle A–B: ",
        "Face A: flat to",
        "focal length, px",
        "Between them",
        "showing all",
        "does not state its verdict",
    ):
        visit.wait_for(text)


def test_the_cloud_is_shown_and_can_be_hidden(visit: Visit) -> None:
    with_everything = visit.at_rest(lambda colours: colours > 50)
    for part in ("Devices", "Faces, ruler", "Labels"):
        visit.page.get_by_label(part, exact=True).uncheck()
    visit.at_rest(lambda colours: 10 < colours < with_everything)


def test_the_view_has_a_scale_and_is_kept_as_it_is(visit: Visit, served: Served) -> None:
    bar = visit.page.get_by_role("img", name=re.compile(r"scale bar: [\d.]+ mm"))
    assert 40 < bar.locator("div").evaluate("bar => bar.getBoundingClientRect().width") < 160
    expect(visit.page.get_by_label("Ceiling", exact=True)).to_be_disabled()  # this cloud has none
    box = visit.page.locator("canvas").first.bounding_box()
    assert box
    visit.page.get_by_text("Keep the view").click()
    for button, name, size in (
        ("Picture, twice its size (PNG)", "room-view.png", 2.0),
        ("A turn around it (GIF)", "room-turn.gif", 720 / max(box["width"], box["height"])),
    ):
        with visit.page.expect_download() as download:
            visit.press(button)
        assert download.value.suggested_filename == name
        with Image.open(download.value.path()) as picture:
            assert picture.size == pytest.approx((size * box["width"], size * box["height"]), abs=2)
            assert len(np.unique(np.asarray(picture.convert("L")))) > 20, "the cloud is in it"
    visit.wait_for("Saved as turn.gif")


def test_points_are_thinned_and_coloured(visit: Visit) -> None:
    visit.choose("Cloud", "Capture 2")
    visit.page.get_by_role("combobox", name="Show").wait_for()  # only of one capture
    visit.choose("Colour", "Faces")
    visit.wait_for("A orange, B sky blue, C green")
    visit.choose("Colour", "Uncertainty of depth")
    visit.wait_for("Standard deviation of the depth.")
    visit.page.get_by_role("img", name="colours from ").wait_for()
    visit.choose("Show", "Surface")
    visit.wait_for(" triangles.")
    visit.choose("Show", "Points")
    percent = visit.page.locator(".mantine-NumberInput-input").first  # the slider's
    percent.fill("25")
    percent.press("Enter")
    visit.wait_for("Showing 1 in 4 of")


def test_two_clicks_measure_a_distance(visit: Visit) -> None:
    visit.wait_for("Click on a point of the cloud")
    visit.press("Back to the first view")
    visit.at_rest(lambda colours: colours > 10)
    box = visit.page.locator("canvas").first.bounding_box()
    assert box
    points = [(x, y) for y in (0.5, 0.55, 0.6, 0.65, 0.7) for x in (0.4, 0.45, 0.5, 0.55, 0.6)]
    told = visit.page.get_by_text("Distance:")
    for x, y in points:  # until two of them were on the cloud
        visit.page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        visit.page.wait_for_timeout(300)
        if told.count():
            break
    visit.wait_for("Distance:")
    assert re.search(r"Distance: [\d.]+\s±\s[\d.]+\smm", told.first.inner_text())
    visit.set_number("Known distance, mm", "1000")
    visit.wait_for("scale: {baseline_m: ")
    visit.press("Forget the points")
    visit.wait_for("Click on a point of the cloud")


def test_a_crop_is_downloaded(visit: Visit) -> None:
    visit.page.get_by_text("Cut out a part").click()
    visit.set_number("From face A, mm", "100")
    visit.wait_for(" in all.")
    with visit.page.expect_download() as download:
        visit.press("Download this part")
    part = read_cloud(Path(download.value.path()))
    assert 100 < len(part) < 30_000
    visit.press("The whole again")
    visit.wait_for("Showing 1 in 4 of")


def test_a_box_is_kept_as_a_step_and_taken_back(visit: Visit, room: Path) -> None:
    visit.press("Keep only this part")
    visit.wait_for("the box holds everything")
    visit.set_number("From face A, mm", "100")
    visit.wait_for(" in all.")
    visit.press("Keep only this part")
    visit.wait_for("Steps: box.")
    (step,) = read_steps(room)
    assert step.name == "box"
    kept = len(read_cleaned(room).cloud())
    assert 100 < kept < 0.9 * len(read_cleaned(room, steps=[]).cloud())
    visit.press("Take the last step back")
    visit.page.get_by_text("Steps: box.").wait_for(state="detached")
    assert read_steps(room) == ()


def test_the_report_is_one_click_away(visit: Visit, served: Served) -> None:
    with visit.page.context.expect_page() as opened:
        visit.page.get_by_text("Open the report").click()
    expect(opened.value.get_by_text("A report's own words")).to_be_visible()
    opened.value.close()


def test_the_page_follows_dark_mode_and_fits_800_pixels(browser: Browser, served: Served) -> None:
    page = browser.new_page(viewport={"width": 800, "height": 700}, color_scheme="dark")
    page.goto(served.address)
    page.get_by_text("Points, %").wait_for()
    assert page.locator("html").get_attribute("data-mantine-color-scheme") == "dark"
    box = page.locator("canvas").first.bounding_box()
    assert box
    assert 350 < box["width"] < 500
    assert page.evaluate("document.documentElement.scrollWidth") <= 800
    page.close()


def test_the_page_is_readable_and_loads_nothing_external(visit: Visit) -> None:
    assert visit.small_texts() == []
    assert visit.complaints == []
    assert visit.foreign == []


def test_ctrl_c_ends_the_program(served: Served, visit: Visit) -> None:
    code, said = served.interrupt()
    assert code == 130
    assert "Traceback" not in said


def test_a_folder_that_is_no_result_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(tmp_path), "--no-browser"]) == 2
    assert "expected a result folder" in capsys.readouterr().err
