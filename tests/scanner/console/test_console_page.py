"""`scan console` in a real browser, with a small simulated rig."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from scanner.capture import open_capture
from scanner.commands import main
from scanner.configuration import load_config
from scanner.io import read_calibration
from tests.support.browsing import PATIENCE_MS, Served, Visit, visiting
from tests.support.notebook import until as until_within
from tests.support.small_capture import CONFIG

pytestmark = pytest.mark.xdist_group("browser")

# More than a thousand frames: long enough to be cancelled.
LONG = CONFIG.replace("quick", f"standard, shifts: 64, exposures_us: {list(range(20_000, 28_000, 1_000))}")
RIGS = "{cameras: {left: {rig: {pose: 0}}, right: {rig: {pose: 1}}}, projectors: {stage: {rig: {projector_pose: 0}}}}"
NETWORK = f"{CONFIG}rigs: {RIGS}\n"


@dataclass
class Console:
    """A console, its page, and its working folder."""

    folder: Path
    served: Served
    visit: Visit

    @property
    def config(self) -> Path:
        return self.folder / "room.yaml"


@pytest.fixture(scope="module")
def console(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    folder = tmp_path_factory.mktemp("console")
    (folder / "room.yaml").write_text(CONFIG)
    with Served(folder, "console", "--config", "room.yaml") as served, visiting(browser, served.address) as visit:
        yield Console(folder, served, visit)


until = partial(until_within, patience_s=PATIENCE_MS / 1000)


def test_the_live_image_follows_the_exposure(console: Console) -> None:
    visit = console.visit
    visit.wait_for("Exposed for")
    expect(visit.page.get_by_alt_text("what the camera sees")).to_be_visible()
    visit.set_number("Exposure, ms", "90")
    visit.wait_for("Exposed for 90 ms. Clipped: ")
    assert visit.page.get_by_text("Clipped: 0.0 %").count() == 0
    visit.set_number("Exposure, ms", "20")
    visit.wait_for("Exposed for 20 ms. Clipped: 0.0 %")
    visit.choose("Projector", "Black")
    visit.wait_for("median 0 % of the range")


def test_the_camera_has_the_large_area_until_there_is_a_cloud(console: Console) -> None:
    visit = console.visit
    visit.choose("Projector", "White")
    visit.wait_for("Clipped: 0.0 %")
    whole = visit.at_rest(lambda colours: colours > 8)
    box = visit.page.locator("canvas").first.bounding_box()
    assert box
    # Beside the lit wall it is dark: of single pixels there are fewer kinds than of the whole.
    visit.page.mouse.click(box["x"] + 0.9 * box["width"], box["y"] + 0.2 * box["height"])
    single = visit.at_rest(lambda colours: colours < whole / 2)
    visit.page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    visit.at_rest(lambda colours: colours > 2 * single)  # how many there are of the whole varies with its noise


def test_buttons_that_cannot_work_say_why(console: Console) -> None:
    """Buttons that cannot work say why while the pointer is on them."""
    page = console.visit.page
    for name, reason in (
        ("Live clouds", "The rig is not calibrated"),
        ("Network", "The configuration names no network"),
    ):
        button = page.get_by_role("button", name=name, exact=True)
        expect(button).to_be_disabled()
        expect(page.get_by_text(reason)).to_be_hidden()
        button.hover(force=True)
        expect(page.get_by_text(reason)).to_be_visible()


_NOTES_UNSAVED = """() => new MutationObserver(() => {
  const found = document.body.innerText.match(/written; showing (all|1 in)[^.]* points/);
  if (found) window.unsaved = found[0];
}).observe(document.body, {subtree: true, childList: true, characterData: true})"""


def test_a_scan_shows_progress_then_the_cloud(console: Console) -> None:
    visit = console.visit
    before = visit.colours_in_scene()
    visit.page.evaluate(_NOTES_UNSAVED)
    visit.press("Scan")
    visit.wait_for("Scanning")
    expect(visit.page.get_by_role("progressbar")).to_be_visible()
    expect(visit.page.get_by_role("button", name="Check", exact=True)).to_be_disabled()
    expect(visit.page.get_by_role("button", name="Scan", exact=True)).to_have_count(0)
    visit.wait_for("Points, %")
    for text in ("Calibrated", "focal length, px", "Angle A–B: ", "Open the report"):
        visit.wait_for(text)
    assert visit.page.evaluate("window.unsaved").startswith("written; showing "), "the cloud was there before its files"
    visit.at_rest(lambda colours: colours > before + 30)
    result = console.folder / "scans" / "room"
    assert read_calibration(result / "calibration.yaml").sigma.camera.focal_px
    assert {frame[0] for frame in open_capture(result / "capture").read_back} == {20_000.0}


def test_a_cancelled_scan_keeps_what_was_captured(console: Console) -> None:
    visit = console.visit
    console.config.write_text(LONG)  # read anew for each scan
    visit.press("Scan")
    kept = console.folder / "scans" / ".room-2"
    until(lambda: any(console.folder.glob("scans/.room*/capture/frames/003.png")))
    visit.wait_for("Capturing and decoding, ")
    visit.press("Cancel")
    visit.wait_for("frames captured so far are in scans/room-2-incomplete/capture")
    assert len(open_capture(console.folder / "scans/room-2-incomplete/capture").files) >= 3
    assert not kept.exists()
    assert not (console.folder / "scans" / "room-2").exists()


def test_errors_give_a_message_instead_of_a_traceback(console: Console) -> None:
    visit = console.visit
    console.config.write_text(CONFIG.replace("furniture", "furnitur"))
    visit.press("Live image")
    visit.wait_for("did you mean 'rig.furniture'?")
    assert visit.page.get_by_text("Traceback").count() == 0
    console.config.write_text(CONFIG)


def test_the_check_shows_its_findings(console: Console) -> None:
    visit = console.visit
    visit.press("Check")
    visit.wait_for("Checking")
    visit.wait_for("Use the exposure that it proposes")
    expect(visit.page.get_by_text("A scan works").or_(visit.page.get_by_text("Ready to scan")).first).to_be_visible()
    for row in ("camera, ok", "exposure, ", "coverage, "):
        visit.wait_for(row)
    visit.press("Write it into the configuration")
    visit.wait_for("Written into room.yaml")
    exposure_us = load_config(console.config).required_rig.exposure_us
    assert exposure_us is not None
    assert 1_000 < exposure_us < 1e6
    assert console.config.read_text() == CONFIG.replace("ambient: 0}", f"ambient: 0, exposure_us: {exposure_us}}}")


def test_a_refused_capture_of_another_program_appears_with_its_reason(console: Console) -> None:
    visit, folder = console.visit, console.folder / "scans" / "from-elsewhere"
    assert (
        main(["--config", str(console.config), "--out", str(folder), "--set", "rig.exposure_us=1000", "--quiet"]) == 4
    )
    visit.press("History")
    visit.wait_for("from-elsewhere")
    visit.wait_for("✕ Not calibrated")
    visit.press("Open from-elsewhere")
    visit.wait_for("Result: from-elsewhere")
    visit.page.get_by_text("Files", exact=True).click()
    with visit.page.expect_download() as download:
        visit.press("Download report.html")
    assert download.value.suggested_filename == "from-elsewhere-report.html"
    assert Path(download.value.path()).read_bytes() == (folder / "report.html").read_bytes()


@pytest.fixture
def scanned(console: Console) -> Console:
    """With a result, which earlier tests leave, or this one makes if it runs alone."""
    room = console.folder / "scans" / "room"
    assert room.exists() or main(["--config", str(console.config), "--out", str(room), "--quiet"]) == 0
    return console


def test_an_earlier_result_is_opened_by_keyboard(scanned: Console) -> None:
    visit = scanned.visit
    visit.page.mouse.click(1000, 900)  # keys are the page's outside of its fields
    visit.page.keyboard.press("Shift+H")
    visit.page.get_by_role("button", name="Open room", exact=True).wait_for()
    visit.page.get_by_role("button", name="Scan", exact=True).focus()
    for _ in range(60):
        visit.page.keyboard.press("Tab")
        if visit.page.evaluate("document.activeElement.innerText") == "Open room":
            break
    visit.page.keyboard.press("Enter")
    visit.wait_for("Result: room")


def test_a_result_gets_a_name_and_a_note_and_comes_back_from_the_bin(scanned: Console) -> None:
    visit, scans = scanned.visit, scanned.folder / "scans"
    visit.press("History")
    visit.press("Open room")
    visit.wait_for("Result: room")
    visit.press("History")
    visit.page.get_by_text("Rename, note, delete").click()
    expect(visit.page.get_by_role("button", name="Rename", exact=True)).to_be_disabled()
    note = visit.page.locator("textarea:visible").first
    note.fill("the lamp was on")
    visit.press("Save the note")
    visit.wait_for("The note is saved.")
    expect(visit.page.locator(".scan-chosen")).to_contain_text("the lamp was on")
    assert (scans / "room" / "note.txt").read_text() == "the lamp was on"
    visit.page.locator(".mantine-TextInput-input:visible").last.fill("../hall")
    visit.press("Rename")
    visit.wait_for("It is called hall now.")
    assert (scans / "hall" / "calibration.yaml").is_file()
    expect(visit.page.locator(".scan-chosen")).to_contain_text("hall")
    visit.press("Delete")
    visit.wait_for("hall is in the bin")
    assert not (scans / "hall").exists()
    expect(visit.page.get_by_role("button", name="Open hall", exact=True)).to_have_count(0)
    visit.press("Undo delete of hall")
    visit.wait_for("hall is back.")
    visit.page.locator(".mantine-TextInput-input:visible").last.fill("room")
    visit.press("Rename")
    visit.wait_for("It is called room now.")
    assert (scans / "room" / "note.txt").read_text() == "the lamp was on"


def test_two_results_are_compared_side_by_side(scanned: Console) -> None:
    visit, folder = scanned.visit, scanned.folder / "scans" / "other"
    assert main(["--config", str(scanned.config), "--out", str(folder), "--quiet"]) == 0
    visit.press("History")
    expect(visit.page.locator(".scan-chosen")).to_contain_text("other", timeout=PATIENCE_MS)  # the newest
    visit.choose("Compare with", "scans/room")
    visit.press("Compare")
    with visit.page.context.expect_page() as opened:
        visit.page.get_by_text("Open the comparison, with maps").click()
    expect(opened.value.get_by_text("By depth")).to_be_visible()
    opened.value.close()
    visit.wait_for("in sigmas")


def test_the_configuration_is_checked_while_typing(console: Console) -> None:
    visit, before = console.visit, console.config.read_text()
    visit.press("Capture")
    visit.page.get_by_text("Configuration", exact=True).click()
    field = visit.page.locator("textarea").first
    expect(field).to_have_value(before)
    field.fill(before.replace("furniture", "furnitur"))
    visit.wait_for("did you mean 'rig.furniture'?")
    expect(visit.page.get_by_role("button", name="Save", exact=True)).to_be_disabled()
    field.fill(before + "# a word on it\n")
    visit.wait_for("This can be saved.")
    visit.press("Save")
    visit.wait_for("The original file is")
    assert console.config.read_text() == before + "# a word on it\n"
    console.config.write_text(before)
    expect(field).to_have_value(before, timeout=PATIENCE_MS)


def test_several_captures_with_a_sound_and_the_way_to_the_next(console: Console) -> None:
    visit = console.visit
    visit.page.get_by_text("Next scan").click()
    visit.set_number("Captures", "2")
    visit.tick("Sound after a capture")
    visit.press("Scan")
    visit.wait_for("So far the focal lengths are known to")
    assert visit.page.locator("audio[autoplay]").count() == 1
    visit.page.get_by_role("combobox", name="Cloud", exact=True).wait_for()  # all captures, or one of them
    assert any(console.folder.glob("scans/room*/captures/1/cloud.ply"))
    visit.set_number("Captures", "1")


def test_a_network_shows_who_sees_whose_light(console: Console) -> None:
    visit, before = console.visit, console.config.read_text()
    console.config.write_text(NETWORK)
    visit.press("Capture")
    graph = visit.page.get_by_role("img", name="left in the light of stage: ")
    expect(graph).to_have_accessible_name(re.compile("right in the light of stage: waiting"), timeout=PATIENCE_MS)
    visit.page.mouse.click(1000, 900)
    visit.page.keyboard.press("Shift+N")
    visit.wait_for("in the light of stage, ")
    visit.wait_for("devices fit together as one network")
    visit.wait_for("Showing all")
    visit.press("Capture")
    of_all = (
        r"left in the light of stage: \d+\.\d % of its picture\. right in the light of stage: \d+\.\d % of its picture"
    )
    expect(graph).to_have_accessible_name(re.compile(of_all))
    for camera in ("left", "right"):
        expect(visit.page.get_by_alt_text(f"what {camera} sees")).to_be_visible(timeout=PATIENCE_MS)
    expect(visit.page.get_by_role("progressbar", name="stage")).to_have_js_property("position", 1)
    visit.choose("Look at", "right in the light of stage")
    visit.press("Live image")
    visit.wait_for("What right sees")
    console.config.write_text(before)


def test_the_page_is_readable_and_loads_nothing_external(console: Console) -> None:
    assert console.visit.small_texts() == []
    assert console.visit.complaints == []
    assert console.visit.foreign == []


def test_ctrl_c_ends_the_program_and_keeps_a_running_capture(console: Console) -> None:
    console.config.write_text(LONG)
    console.visit.press("Scan")
    until(lambda: any(console.folder.glob("scans/.room*/capture/frames/003.png")))
    code, said = console.served.interrupt()
    assert code == 130
    assert re.search(r"captured so far are in scans/room(-\d+)?-incomplete(-\d+)?/capture", " ".join(said.split()))
    assert "Traceback" not in said


def test_missing_settings_are_named_before_the_page_opens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "room.yaml").write_text("rig: {backend: simulated}\n")
    assert main(["console", "--config", str(tmp_path / "room.yaml"), "--no-browser"]) == 2
    assert "give the size of its image" in capsys.readouterr().err
