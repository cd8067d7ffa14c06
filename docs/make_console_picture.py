"""Make docs/images/console.png from a result:  python docs/make_console_picture.py scans/room-sim

Opens `scan console` on the simulated rig in a real browser, and the result in it.
"""

import argparse
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from playwright.sync_api import Page, expect, sync_playwright

_ROOT = Path(__file__).parents[1]
_TARGET = Path(__file__).parent / "images" / "console.png"
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_SIZE = {"width": 1500, "height": 900}
_PATIENCE_MS = 120_000
_SETTLING_MS = 25_000  # in software a frame takes seconds
_LEVELS = 40  # of a colour: photographs and point clouds need no more, and the file is half as large


def photograph(page: Page) -> np.ndarray:
    """Wait for the live image, open the only earlier result, and take the page's picture, BGR."""
    expect(page.get_by_alt_text("what the camera sees")).to_be_visible(timeout=_PATIENCE_MS)
    page.locator(".mantine-Notification-closeButton").dispatch_event("click")  # that this browser draws in software
    page.get_by_role("button", name="History", exact=True).click()
    page.get_by_role("button", name=re.compile("^Open ")).click()
    expect(page.get_by_text("Points, %")).to_be_visible(timeout=_PATIENCE_MS)
    page.wait_for_timeout(_SETTLING_MS)
    return cv2.imdecode(np.frombuffer(page.screenshot(timeout=_PATIENCE_MS), np.uint8), cv2.IMREAD_COLOR)


def main() -> None:
    """Serve, look, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", type=Path, help="a result folder")
    result = parser.parse_args().result.resolve()
    browser = next(filter(None, map(shutil.which, _BROWSERS)))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scans").mkdir()
        (Path(folder) / "scans" / result.name).symlink_to(result)
        config = str(_ROOT / "configs" / "room-sim.yaml")
        command = [sys.executable, "-m", "scanner", "console", "--config", config, "--no-browser"]
        served = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
        try:
            address = next(word for word in served.stdout.readline().split() if word.startswith("http://"))
            with sync_playwright() as playwright:
                page = playwright.chromium.launch(executable_path=browser, args=_FLAGS).new_page(viewport=_SIZE)
                page.goto(address)
                picture = photograph(page)
        finally:
            served.send_signal(signal.SIGINT)
            served.wait()
    step = 255 / (_LEVELS - 1)
    cv2.imwrite(
        str(_TARGET), np.rint(np.rint(picture / step) * step).astype(np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 9]
    )
    print(_TARGET)


if __name__ == "__main__":
    main()
