"""One browser for all tests of pages."""

from collections.abc import Iterator

import pytest

pytest.importorskip("viser", reason="the page needs the extra 'console'")
pytest.importorskip("playwright", reason="pages are tested with Playwright")

from browsing import CHROMIUM, FLAGS, MISSING
from playwright.sync_api import Browser, sync_playwright


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip(MISSING)
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield launched
        launched.close()
