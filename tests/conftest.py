"""Fixtures of all tests."""

import gc
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytest_plugins = ["tests.support.costs"]
pytest.register_assert_rewrite("tests.support")  # what a check there found is told as in a test

# As the command does (scanner/commands/main.py); with several test processes on two cores it matters even more.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Scripts ignore Ctrl-C in the background, and nohup that the terminal closes: what tests start would inherit it.
for ignored, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(ignored) == signal.SIG_IGN:
        signal.signal(ignored, usual)

# No test is timed: the first example may wait for a compiler, any for a busy machine. Every run has the same examples,
# so that a failure comes from a change; `pytest --hypothesis-profile random` looks for new ones.
settings.register_profile("random", deadline=None, print_blob=True)
settings.register_profile("same", deadline=None, derandomize=True)
settings.load_profile("same")

# Groups of tests.
_LONGEST = ("loopback", "browser", "rooms", "end to end", "end to end jointly", "faults", "installed package", "words")
_NAMES = ("chromium", "chromium-browser", "google-chrome")
# In software, and talking to nobody.
_FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


# Objects that are made before the garbage collector looks at the young ones: it took a tenth of some tests.
gc.set_threshold(10_000)


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups; folders' own are told earlier
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the tests of a file in one process, as far as they belong to no other group: what they share is made once.

    Groups that take longest begin first: at the end, no process is to wait for one of them.
    """
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.location[0]))
    items.sort(key=lambda item: not any(mark.args[0] in _LONGEST for mark in item.iter_markers("xdist_group")))


def pytest_collection_finish() -> None:
    """Let the garbage collector leave out the modules and tests, which stay to the end."""
    gc.freeze()


@pytest.fixture(scope="session")
def browser() -> Iterator["Browser"]:
    """Chromium without a window, shared by all tests of pages, which run in one group for that."""
    driver = pytest.importorskip("playwright.sync_api", reason="pages are tested with Playwright")
    chromium = next(filter(None, map(shutil.which, _NAMES)), None)
    if chromium is None:
        pytest.skip("no Chromium on this computer: apt-get install chromium")
    from tests.support.browsing import PATIENCE_MS  # which needs Playwright

    driver.expect.set_options(timeout=PATIENCE_MS)  # instead of five seconds
    with driver.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=chromium, args=list(_FLAGS))
        yield launched
        launched.close()


@pytest.fixture
def capture_folder(tmp_path: Path) -> Path:
    """The smallest capture folder."""
    from tests.support.small_capture import write_capture  # loads NumPy, after what is set above

    return write_capture(tmp_path / "room")
