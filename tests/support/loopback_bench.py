"""A loopback rig for tests, scans with it, and the expected frames.

Screens without a display: a projector that replaces a window, and the loopback rig's, which a test draws on.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Thread

import numpy as np

from hw.loopback import CameraProcess, LoopbackSettings, VirtualScreen, camera_process, shown_on, virtual_screen
from hw.projector import Screen
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from hw.timing import Swap
from scanner.capture import Recording, open_capture
from scanner.commands import main
from scanner.patterns import Pattern, draw

CAMERA, PROJECTOR = (306, 256), (320, 180)
ROOM = {"seed": 2, "furniture": False, "interreflection": False}  # which is built in a fifth of the time
CONFIG = f"""
rig: {{backend: aravis, camera: 127.0.0.1, exposure_us: 33333, refresh_hz: 60, packet_size: 8000}}
camera: {{width: {CAMERA[0]}, height: {CAMERA[1]}}}
projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}
sequence: {{preset: quick, cell: 12, inverses: true}}
corner: {{squareness_deg: 0}}
"""


class SimulatedWindow:
    """A window of (width, height); `show_light` is called with each flipped picture."""

    renderer = "none"

    def __init__(self, size: tuple[int, int], show_light: Callable[[np.ndarray], object]) -> None:
        self.size = size
        self.screen = Screen(0, "screen", 0, 0, *size, 60.0)
        self._show_light = show_light
        self._prepared = np.zeros(size[::-1], np.uint8)

    def prepare(self, image: np.ndarray) -> None:
        self._prepared = image

    def flip(self) -> Swap:
        begun_s = time.monotonic()
        self._show_light(self._prepared)
        return Swap(begun_s, time.monotonic())

    def show(self, image: np.ndarray) -> None:
        self.prepare(image)
        self.flip()


SIZE = (6, 4)


class FakeScreen:
    """A screen that a test draws on; `looked_s`: time of the last look at it."""

    def __init__(self) -> None:
        self.level = 0
        self.looked_s = 0.0

    def pixels(self) -> np.ndarray:
        self.looked_s = time.monotonic()
        return np.full(SIZE[::-1], self.level * 0x010101, np.uint32)


def as_light(image: np.ndarray) -> np.ndarray:
    return image.astype(np.float32)


@dataclass(frozen=True)
class Loopback:
    """A screen and a camera that looks at it."""

    screen: VirtualScreen
    camera: CameraProcess

    @property
    def alive(self) -> bool:
        return self.screen.process.poll() is None and self.camera.process.poll() is None


class Keeper:
    """Keeps a rig running between tests, and starts a new one after a test has killed it."""

    def __init__(self) -> None:
        self._running = ExitStack()
        self._rig: Loopback | None = None

    def rig(self) -> Loopback:
        if self._rig is None or not self._rig.alive:
            self.end()
            screen = self._running.enter_context(virtual_screen(PROJECTOR))
            self._running.enter_context(shown_on(screen))
            settings = LoopbackSettings(camera_size=CAMERA, room=SimulatedRigSettings.model_validate(ROOM))
            self._rig = Loopback(screen, self._running.enter_context(camera_process(screen, settings)))
        return self._rig

    def end(self) -> None:
        self._rig = None
        self._running.close()


def scan(config: Path, *more: str) -> tuple[int, Path]:
    """Run a scan; returns the exit code, and the folder of the capture."""
    out = config.with_name("result")
    code = main(["--config", str(config), "--out", str(out), "--quiet", *more])
    return code, (out if code in (0, 4) else out.with_name("result-incomplete")) / "capture"


def after_frames(count: int, config: Path, act: Callable[[], object]) -> None:
    """Run an action once a scan has recorded this many frames."""

    def recorded() -> int:
        listings = config.parent.glob(".result*/capture/capture.yaml")
        return sum(listing.read_text().count("file:") for listing in listings)

    def watch() -> None:
        while recorded() < count:
            time.sleep(0.005)
        act()

    Thread(target=watch, daemon=True).start()


def broken_off(config: Path, number: signal.Signals) -> tuple[int, str]:
    """Run a scan as a process and send it a signal after five frames; returns exit code and messages."""
    command = [sys.executable, "-X", "faulthandler", "-m", "scanner"]
    command += ["--config", str(config), "--out", str(config.with_name("result"))]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        after_frames(5, config, lambda: process.send_signal(number))
        try:
            message = process.communicate(timeout=60)[1]
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)  # it tells where it hangs, and lets go of the camera
            message = process.communicate()[1]
        return process.returncode, message


@lru_cache(64)
def digits(room: SimulatedRoom, pattern: Pattern, size: tuple[int, int]) -> np.ndarray:
    """Expected noise-free frame of a pattern of this size, (width, height)."""
    return room.electrons(draw(pattern, size)) * (255 / room.sensor.full_well_electrons)


def wrong_frames(recording: Recording, room: SimulatedRoom, most: float = 0.02) -> list[str]:
    """Errors of frames that do not show their own pattern with less than the share `most` of a neighbouring one."""
    frames = [frame.image.astype(float) for _, frame in recording.stream().frames]
    seen = [digits(room, pattern, recording.projector_size) for pattern in recording.patterns]
    wrong = []
    for index, (frame, own) in enumerate(zip(frames, seen, strict=True)):
        if np.sqrt(np.mean((frame - own) ** 2)) >= 2.5:
            wrong.append(f"frame {index} is not of {recording.patterns[index]}")
        for other in seen[max(0, index - 1) : index] + seen[index + 1 : index + 2]:
            towards = other - own
            share = np.sum(towards * (frame - own)) / np.sum(towards**2)
            if abs(share) >= most:
                wrong.append(f"{100 * share:.1f} % of frame {index} are of a neighbouring pattern")
    return wrong


def check_frames(capture: Path, room: SimulatedRoom) -> int:
    """Check that every frame shows exactly its own pattern. Returns the number of frames."""
    recording = open_capture(capture)
    assert wrong_frames(recording, room) == []
    return len(recording.patterns)
