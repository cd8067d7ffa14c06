"""Starts and ends the processes of the loopback rig: the virtual screen and the camera that sees it."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from hw.errors import DeviceError
from hw.settings import SimulatedRigSettings

_START_TIMEOUT_S = 60.0


class LoopbackSettings(BaseModel):
    """The camera of the loopback rig and the room that it looks at."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    camera_size: tuple[int, int] = Field(description="Width and height of the sensor in pixels.")
    room: SimulatedRigSettings = Field(
        default_factory=lambda: SimulatedRigSettings.model_validate({}),
        description="The room.",
    )
    latency_ms: float = Field(default=50.0, ge=0.0, le=500.0, description="From screen to light.")
    white_exposure_us: float = Field(
        default=100_000 / 3,
        gt=0.0,
        description="Exposure at which white reaches 85 % of the range, without gain.",
    )
    lost_packets: float = Field(default=0.0, ge=0.0, le=1.0, description="Share of packets that get lost.")
    address: str = Field(default="127.0.0.1", description="Where the camera answers.")
    serial: str = Field(default="loopback", description="Its serial number.")


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
            shown = number.readline().decode().strip()  # empty if it ended before it was ready
            if not shown:
                raise DeviceError(f"the loopback rig's projector: {' '.join(command)} ended with {process.wait()}")
            yield VirtualScreen(f":{shown}", Path(folder) / "Xvfb_screen0", process)
        finally:
            process.terminate()
            process.wait()


@contextmanager
def camera_process(screen: VirtualScreen, settings: LoopbackSettings) -> Iterator[subprocess.Popen[bytes]]:
    """A camera that sees the screen's light in a room, in a process of its own, found by anyone once this yields.

    Raises DeviceError if it does not start.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "hw.loopback", "--screen", str(screen.file), "--settings", settings.model_dump_json()],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdin
    assert process.stdout
    assert process.stderr
    try:
        if process.stdout.readline() != b"ready\n":
            raise DeviceError(process.stderr.read().decode(errors="replace").strip() or "the loopback camera failed")
        yield process
    finally:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout, process.stderr):
            pipe.close()


@contextmanager
def loopback_rig(settings: LoopbackSettings, projector_size: tuple[int, int]) -> Iterator[VirtualScreen]:
    """Screen and camera together; DISPLAY names the screen while the context lasts. Raises DeviceError."""
    with virtual_screen(projector_size) as screen, shown_on(screen), camera_process(screen, settings):
        yield screen


@contextmanager
def shown_on(screen: VirtualScreen) -> Iterator[None]:
    """Windows of this process and its children open on that screen."""
    before = os.environ.get("DISPLAY")
    os.environ["DISPLAY"] = screen.display
    try:
        yield
    finally:
        if before is None:
            del os.environ["DISPLAY"]
        else:
            os.environ["DISPLAY"] = before
