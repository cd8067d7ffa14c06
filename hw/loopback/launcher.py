"""Starts and stops the processes of the loopback rig: the virtual screen and the camera."""

import os
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from hw.errors import DeviceError
from hw.loopback.settings import Conditions, LoopbackSettings


@dataclass(frozen=True)
class VirtualScreen:
    """An X server without hardware: `display` is its name for DISPLAY, `file` where it keeps its pixels."""

    display: str
    file: Path
    process: subprocess.Popen[bytes]


@contextmanager
def virtual_screen(size: tuple[int, int]) -> Iterator[VirtualScreen]:
    """An X server with one screen of (width, height) for as long as the context lasts.

    Raises DeviceError if there is no Xvfb, or it does not start.
    """
    if shutil.which("Xvfb") is None:
        raise DeviceError("the loopback rig's projector needs Xvfb, which is not installed: apt-get install xvfb")
    read_end, write_end = os.pipe()
    with tempfile.TemporaryDirectory(prefix="loopback-") as folder, os.fdopen(read_end, "rb") as number:
        command = ["Xvfb", "-displayfd", str(write_end), "-screen", "0", f"{size[0]}x{size[1]}x24"]
        command += ["-fbdir", folder, "-nolisten", "tcp", "-noreset"]
        process = subprocess.Popen(command, pass_fds=[write_end], stderr=subprocess.DEVNULL)
        os.close(write_end)
        try:
            display = number.readline().decode().strip()  # empty if it ended before it was ready
            if not display:
                raise DeviceError(f"the loopback rig's projector: {' '.join(command)} ended with {process.wait()}")
            yield VirtualScreen(f":{display}", Path(folder) / "Xvfb_screen0", process)
        finally:
            process.terminate()
            process.wait()


class CameraProcess:
    """A running camera process."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self._await_ready()

    def change(self, conditions: Conditions) -> None:
        """Change the conditions from now on. Raises DeviceError."""
        assert self.process.stdin
        self.process.stdin.write(conditions.model_dump_json() + "\n")
        self.process.stdin.flush()
        self._await_ready()

    def _await_ready(self) -> None:
        assert self.process.stdout
        assert self.process.stderr
        if self.process.stdout.readline() != "ready\n":
            raise DeviceError(self.process.stderr.read().strip() or "the loopback camera failed")


@contextmanager
def camera_process(
    screen: VirtualScreen, settings: LoopbackSettings, *further: VirtualScreen
) -> Iterator[CameraProcess]:
    """Run the camera that sees the light of one screen or several in a process of its own; it can be found once this
    yields.

    Raises DeviceError if it does not start.
    """
    command = [sys.executable, "-m", "hw.loopback"]
    for virtual_screen in (screen, *further):
        command += ["--screen", str(virtual_screen.file)]
    command += ["--settings", settings.model_dump_json()]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            yield CameraProcess(process)
        finally:
            process.kill()


@contextmanager
def loopback_rig(settings: LoopbackSettings, projector_size: tuple[int, int]) -> Iterator[VirtualScreen]:
    """Run screen and camera; DISPLAY is set to the screen in this context. Raises DeviceError."""
    with virtual_screen(projector_size) as screen, shown_on(screen), camera_process(screen, settings):
        yield screen


@contextmanager
def loopback_network(
    cameras: Sequence[LoopbackSettings], projector_sizes: Sequence[tuple[int, int]]
) -> Iterator[list[VirtualScreen]]:
    """Run a screen for each projector, and cameras that see the light of all of them. Raises DeviceError."""
    with ExitStack() as running:
        screens = [running.enter_context(virtual_screen(size)) for size in projector_sizes]
        processes = [camera_process(screens[0], settings, *screens[1:]) for settings in cameras]
        with ThreadPoolExecutor() as starting:
            list(starting.map(running.enter_context, processes))
        yield screens


def own_addresses() -> list[str]:
    """Addresses of this computer, at each of which a camera can be served: 127.0.0.1, and where there is a network that
    of its interface.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("198.51.100.1", 9))  # of nobody (RFC 5737), and nothing is sent
        except OSError:
            return ["127.0.0.1"]
        return ["127.0.0.1", str(probe.getsockname()[0])]


@contextmanager
def shown_on(screen: VirtualScreen) -> Iterator[None]:
    """Set DISPLAY: windows of this process and its children open on this screen."""
    before = os.environ.get("DISPLAY")
    os.environ["DISPLAY"] = screen.display
    try:
        yield
    finally:
        if before is None:
            del os.environ["DISPLAY"]
        else:
            os.environ["DISPLAY"] = before
