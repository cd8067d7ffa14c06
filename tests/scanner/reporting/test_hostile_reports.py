"""Reports of every kind of result, made in a folder, of a configuration and into results with hostile names, in a real
browser: corner (refused), thing, room, network, board.
"""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from scanner.commands import main
from scanner.results import REPORT_FILE
from tests.support.hostile import FILE_NAME, assert_harmless
from tests.support.places import ROOT

pytestmark = pytest.mark.xdist_group("browser")

QUICK = ("--set", "sequence.preset=quick")
# Light between surfaces takes most of the time that a room takes, and no report shows it.
DARK = ("--set", "rig.interreflection=false", "--set", "rig.ambient=0")
LENSES = ("--set", "lens.decentering=0.0003")  # which a corner in so small a picture does not tell
EMPTY = ("--set", "rig.furniture=false", *DARK)
BOARD = ("--set", "rig.board={square_m: 0.06}", "--board", "chessboard:9x7", "--square", "60mm")
RIG = ("--calibration", f"refused{FILE_NAME}/truth.yaml")


def sizes(camera: tuple[int, int], projector: tuple[int, int]) -> list[str]:
    """Words that set the sizes of both devices."""
    named = (("camera", camera), ("projector", projector))
    return [word for name, (w, h) in named for word in ("--set", f"{name}={{width: {w}, height: {h}}}")]


THING = [*sizes((306, 256), (427, 240)), *QUICK, *EMPTY]
# By kind: the configuration, the exit code, and further words.
COMMANDS = {
    "refused": ("thing-sim", 4, THING),
    "thing": ("thing-sim", 0, [*THING, "--object", "--stations", "4", *RIG]),
    "room": ("room-whole-sim", 0, [*sizes((306, 256), (427, 240)), *QUICK, *DARK, *LENSES, "--stations", "2"]),
    "network": ("hall-sim", 0, sizes((240, 200), (214, 120))),
    "board": ("room-sim", 0, [*sizes((408, 342), (427, 240)), *QUICK, *EMPTY, *BOARD, "--captures", "3"]),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The working folder, with all results."""
    folder = tmp_path_factory.mktemp("reports") / FILE_NAME
    folder.mkdir()
    with contextlib.chdir(folder):
        for kind, (config, code, options) in COMMANDS.items():
            shutil.copy(ROOT / f"configs/{config}.yaml", f"{config}{FILE_NAME}.yaml")
            command = [kind] if kind in ("network", "board") else []
            places = ["--config", f"{config}{FILE_NAME}.yaml", "--out", f"{kind}{FILE_NAME}", "--quiet"]
            assert main([*command, *places, *options]) == code
    return folder


@pytest.fixture
def opened(browser: Browser) -> Iterator[Page]:
    page = browser.new_page()
    yield page
    page.close()


@pytest.mark.parametrize("kind", COMMANDS)
def test_a_report_shows_names_as_text(folder: Path, opened: Page, kind: str) -> None:
    opened.goto((folder / f"{kind}{FILE_NAME}" / REPORT_FILE).as_uri())
    if kind != "board":  # which numbers its captures
        expect(opened.get_by_text("<img src=x onerror=").first).to_be_attached()
    assert_harmless(opened)
    # All of them end the page as they should: no name has begun a comment or a script.
    assert opened.evaluate("document.body.lastElementChild !== null && !document.body.innerHTML.includes('<!--')")
