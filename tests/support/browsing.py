"""A page of this program in a real browser, and its server."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import cv2
import numpy as np
from playwright.sync_api import Browser, ConsoleMessage, Page, expect

from tests.support.notebook import until
from tests.support.places import ROOT

PATIENCE_MS = int(os.environ.get("TEST_PATIENCE_MS", "180000"))  # of tests beside others on a busy machine
_LEAVING_S = 180

_SMALL_TEXTS = """() => {
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
  while (walker.nextNode()) {
    const text = walker.currentNode.textContent.trim(), parent = walker.currentNode.parentElement;
    if (!text || ["STYLE", "SCRIPT"].includes(parent.tagName)) continue;
    const size = parseFloat(getComputedStyle(parent).fontSize);
    if (size < 12) found.push(`${size} px: ${text}`);
  }
  return found;
}"""


class Served:
    """`scan …` as a process, from its first line, which names the address, to Ctrl-C."""

    def __init__(self, folder: Path, *arguments: object) -> None:
        command = [sys.executable, "-m", "scanner", *map(str, arguments), "--no-browser"]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        self._process = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self._process.stdout
        self.first_line = self._process.stdout.readline()

    @property
    def address(self) -> str:
        return next(word for word in self.first_line.split() if word.startswith("http://"))

    def interrupt(self) -> tuple[int, str]:
        """Press Ctrl-C; returns the exit code, and all output on stdout and stderr."""
        self._process.send_signal(signal.SIGINT)
        out, err = self._process.communicate(timeout=_LEAVING_S)
        return self._process.returncode, out + err

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()


class Visit:
    """A page, its console messages, and its requests to other hosts."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.complaints: list[str] = []
        self.foreign: list[str] = []
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self._on_request(request.url))
        page.on("websocket", lambda socket: self._on_request(socket.url))

    def _on_console(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.complaints.append(message.text)

    def _on_request(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("data", "blob") and parts.hostname != "127.0.0.1":
            self.foreign.append(url)

    def press(self, name: str) -> None:
        button = self.page.get_by_role("button", name=name, exact=True)
        expect(button).to_be_enabled(timeout=PATIENCE_MS)
        button.click()

    def wait_for(self, text: str) -> None:
        # Hints of buttons are there before they are seen.
        expect(self.page.get_by_text(text).locator("visible=true").first).to_be_visible(timeout=PATIENCE_MS)

    def set_number(self, label: str, value: str) -> None:
        field = self.page.get_by_label(label, exact=True)
        field.fill(value)
        field.press("Enter")

    def tick(self, label: str) -> None:
        """Tick a box, which on a busy machine shows it some time after the click."""
        box = self.page.get_by_label(label)
        box.click()
        expect(box).to_be_checked(timeout=PATIENCE_MS)

    def choose(self, label: str, option: str) -> None:
        self.page.get_by_role("combobox", name=label, exact=True).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def colours_in_scene(self) -> int:
        """Number of colours in the middle of the 3-D view, in steps of 16 levels."""
        box = self.page.locator("canvas").first.bounding_box()
        assert box
        width, height = box["width"] / 2, box["height"] / 2
        clip: Any = {"x": box["x"] + width / 2, "y": box["y"] + height / 2, "width": width, "height": height}
        seen = cv2.imdecode(np.frombuffer(self.page.screenshot(clip=clip), np.uint8), cv2.IMREAD_COLOR)
        return len(np.unique(seen.reshape(-1, 3) // 16, axis=0))

    def at_rest(self, wanted: Callable[[int], bool]) -> int:
        """Wait until the 3-D view shows a wanted number of colours twice in a row; returns it."""
        seen = [-1, -2]

        def resting() -> bool:
            seen[:] = [self.colours_in_scene(), seen[0]]
            return seen[0] == seen[1] and wanted(seen[0])

        until(resting, PATIENCE_MS / 1000)
        return seen[0]

    def small_texts(self) -> list[str]:
        return list(self.page.evaluate(_SMALL_TEXTS))


@contextmanager
def visiting(browser: Browser, address: str) -> Iterator[Visit]:
    """Open a page, and close it at the end."""
    page = browser.new_page(viewport={"width": 1200, "height": 700})
    page.set_default_timeout(PATIENCE_MS)
    visit = Visit(page)
    page.goto(address)
    try:
        yield visit
    finally:
        page.close()
