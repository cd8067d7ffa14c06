"""The report in Chromium: light, dark, printed, with and without JavaScript."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from scanner.reporting.contents import ReportInput
from scanner.reporting.page import write_report
from scanner.results import Refused
from tests.support.cloud_scene import room
from tests.support.result_folder import calibrated_report, refused_report

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.xdist_group("browser")

# What is drawn: how many pixels are not transparent, and a number that changes with any of them. The viewer draws in
# the animation frame after a change. A change of size is announced one frame later, so the third frame has seen both.
DRAWN = """async () => {
  for (let frame = 0; frame < 3; frame += 1) await new Promise(done => requestAnimationFrame(done));
  const canvas = document.querySelector(".viewer canvas");
  const data = new Uint32Array(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  let filled = 0, sum = 0;
  data.forEach((pixel, i) => { if (pixel) { filled += 1; sum = (sum * 31 + pixel + i) % 1000000007; } });
  return [filled, sum, data.length];
}"""
SMALLEST_TEXT = """() => {
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const sizes = [];
  while (walker.nextNode()) {
    const parent = walker.currentNode.parentElement;
    if (!walker.currentNode.textContent.trim() || ["SCRIPT", "STYLE"].includes(parent.tagName)) continue;
    if (!parent.getClientRects().length) continue;
    const matrix = parent.getScreenCTM ? parent.getScreenCTM() : null;
    const scale = matrix ? Math.min(Math.hypot(matrix.a, matrix.b), Math.hypot(matrix.c, matrix.d)) : 1;
    sizes.push(parseFloat(getComputedStyle(parent).fontSize) * scale);
  }
  return Math.min(...sizes);
}"""
# Tables and plots that have to be scrolled to be seen as a whole.
CUT_OFF = """() => [...document.querySelectorAll(".wide")]
  .filter(element => element.scrollWidth > element.clientWidth + 1)
  .map(element => element.innerText.slice(0, 60))"""
# The lowest contrast of text with the page behind it (WCAG 2.2, 1.4.3), over pictures left out.
LOWEST_CONTRAST = """() => {
  const numbers = colour => colour.match(/[\\d.]+/g).map(Number);
  const luminance = colour => numbers(colour).slice(0, 3).map(value => value / 255)
    .map(value => value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4)
    .reduce((sum, value, i) => sum + value * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = element => {
    for (; element; element = element.parentElement) {
      const colour = getComputedStyle(element).backgroundColor;
      if (numbers(colour).length === 3) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const texts = "h1, h2, h3, h4, p, li, td, th, figcaption, a, button, label, .plot text";
  const ratios = [...document.querySelectorAll(texts)]
    .filter(element => element.getClientRects().length)
    .map(element => {
      const style = getComputedStyle(element);
      const [a, b] = [luminance(element.ownerSVGElement ? style.fill : style.color), luminance(behind(element))];
      return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    });
  return Math.min(...ratios);
}"""


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    scene = room()
    folder = tmp_path_factory.mktemp("reports")
    kinds: dict[str, ReportInput] = {"calibrated": calibrated_report(scene), "refused": refused_report(scene)}
    refused = kinds["refused"].outcome
    assert isinstance(refused, Refused)
    with_faces = Refused(refused.decoded.with_matches(scene.matches, None), refused.refusal)
    kinds["refused-with-faces"] = ReportInput(with_faces)
    for kind, report in kinds.items():
        write_report(folder / f"{kind}.html", report)
    return {kind: folder / f"{kind}.html" for kind in kinds}


@pytest.fixture
def pages(browser: "Browser") -> Iterator[Any]:
    """Opens a file, and fails if the page logs to the console or requests anything external."""
    contexts, complaints = [], []

    def opened(path: Path, **options: Any) -> "Page":
        context = browser.new_context(viewport={"width": 1000, "height": 800}, **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(180_000)  # beside other tests on a busy machine
        page.on("console", lambda message: complaints.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request", lambda request: None if request.url == path.as_uri() else complaints.append(request.url[:99])
        )
        page.goto(path.as_uri())
        page.wait_for_function("document.readyState === 'complete'")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert [complaint for complaint in complaints if not complaint.startswith("data:image/")] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("kind", ["calibrated", "refused", "refused-with-faces"])
def test_text_has_contrast_in_light_and_dark_mode(pages: Any, reports: dict[str, Path], kind: str, scheme: str) -> None:
    page = pages(reports[kind], color_scheme=scheme)
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (max(int(part) for part in background[4:-1].split(",")) < 60) == (scheme == "dark")
    assert page.evaluate(SMALLEST_TEXT) >= 12
    assert page.evaluate(LOWEST_CONTRAST) >= 4.5
    assert page.evaluate("document.documentElement.scrollWidth") <= 1000
    assert page.evaluate(CUT_OFF) == []


def test_the_cloud_is_drawn_and_rotates_with_the_keys(pages: Any, reports: dict[str, Path]) -> None:
    page = pages(reports["calibrated"])
    canvas = page.locator(".viewer canvas")
    canvas.wait_for(state="visible")
    filled, before, total = page.evaluate(DRAWN)
    assert 0.03 * total < filled < 0.9 * total
    canvas.focus()
    seen = {before}
    for key in ("ArrowLeft", "ArrowUp", "+", "Shift+ArrowRight", "-"):
        canvas.press(key)
        seen.add(page.evaluate(DRAWN)[1])
    assert len(seen) == 6
    canvas.press("Home")
    assert page.evaluate(DRAWN)[1] == before


def test_the_cloud_rotates_with_the_mouse_and_buttons(pages: Any, reports: dict[str, Path]) -> None:
    page = pages(reports["calibrated"])
    canvas = page.locator(".viewer canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    seen = {page.evaluate(DRAWN)[1]}
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 80, middle[1] + 30)
    page.mouse.up()
    seen.add(page.evaluate(DRAWN)[1])
    for action in ("From the front", "From above"):
        page.get_by_role("button", name=action).click()
        seen.add(page.evaluate(DRAWN)[1])
    page.get_by_label("outlines").uncheck()
    seen.add(page.evaluate(DRAWN)[1])
    assert len(seen) == 5


def test_print_is_light_with_a_still_picture(pages: Any, reports: dict[str, Path]) -> None:
    page = pages(reports["calibrated"], color_scheme="dark")
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert not page.locator(".viewer canvas").is_visible()
    assert page.locator(".viewer .still img").is_visible()
    page.set_viewport_size({"width": 690, "height": 1000})  # A4 within its margins
    assert page.evaluate(SMALLEST_TEXT) >= 12
    assert page.evaluate("document.documentElement.scrollWidth") <= 690
    assert page.pdf(format="A4").startswith(b"%PDF")


@pytest.mark.parametrize("name", ["calibrated", "refused", "refused-with-faces"])
def test_the_first_printed_page_has_the_main_results(pages: Any, reports: dict[str, Path], name: str) -> None:
    page = pages(reports[name])
    sheet = page.locator(".sheet")
    assert not sheet.is_visible()
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 690, "height": 1000})
    assert 250 < sheet.bounding_box()["height"] < 1010  # of an A4's 1017 px within its margins
    assert page.locator(".sheet .verdict h2").is_visible()
    assert page.locator(".sheet img").first.is_visible()
    assert page.locator("h1:visible").count() == 1
    told = sheet.inner_text()
    assert ("focal length" in told) == (name == "calibrated")


def test_without_javascript_there_is_a_still_picture(pages: Any, reports: dict[str, Path]) -> None:
    page = pages(reports["calibrated"], java_script_enabled=False)
    assert page.locator(".viewer .still img").is_visible()
    assert not page.locator(".viewer canvas").is_visible()


def test_a_foreign_script_does_not_run(browser: "Browser", reports: dict[str, Path], tmp_path: Path) -> None:
    spoiled = tmp_path / "spoiled.html"
    html = reports["calibrated"].read_text(encoding="utf-8")
    spoiled.write_text(html.replace("</main>", "<script>document.title = 'taken'</script></main>"), encoding="utf-8")
    page = browser.new_page()
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.goto(spoiled.as_uri())
    page.locator(".viewer.live").wait_for()
    assert page.title() == "Scan"
    assert any("Content Security Policy" in text for text in said)
    page.close()


def test_a_narrow_screen_does_not_scroll_sideways(pages: Any, reports: dict[str, Path]) -> None:
    page = pages(reports["calibrated"])
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate(SMALLEST_TEXT) >= 12
