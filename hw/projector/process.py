"""The projector: a screen that a child process (`hw/projector/pyglet_window.py`) draws on."""

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from multiprocessing import Pipe
from typing import Any

import numpy as np

from calib.geometry import SQUARE_PIXELS, PixelGrid
from calib.numerics import Image
from hw.errors import DeviceError
from hw.optional_parts import RIG
from hw.projector.screens import Screen, choose_screen, display_of
from hw.timing import Swap

# Timeouts. The first start after an installation compiles shaders and byte code.
_START_TIMEOUT_S = 60.0
_SHOW_TIMEOUT_S = 10.0


class _WindowProcess:
    """The child process and the connection to it. `display`: the X display, None for the desktop's."""

    def __init__(self, display: str | None = None) -> None:
        if importlib.util.find_spec("pyglet") is None:
            raise DeviceError(RIG.missing("the projector", "pyglet"))
        self._unanswered = False
        self._connection, theirs = Pipe()
        self._log = tempfile.TemporaryFile()  # a pipe would fill up and stop the child  # noqa: SIM115
        descriptor = theirs.fileno()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hw.projector.pyglet_window", str(descriptor)],
            pass_fds=[descriptor],
            env=None if display is None else {**os.environ, "DISPLAY": display},
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
        )
        theirs.close()

    def receive(self, timeout_s: float) -> Any:
        """Wait for the child's next answer and return its value. Raises DeviceError if the child failed or is gone."""
        try:
            if not self._connection.poll(timeout_s):
                raise DeviceError(f"it has not answered for {timeout_s:.0f} s")
            outcome, value = self._connection.recv()
        except (EOFError, ConnectionError) as error:
            raise DeviceError(f"its window is gone ({self._last_output()})") from error
        if outcome == "failed":
            raise DeviceError(value)
        return value

    def tell(self, command: str, argument: object, timeout_s: float) -> None:
        """Wait for the answer to the last command, and send another without waiting. Raises DeviceError."""
        self.settle(timeout_s)
        try:
            self._connection.send((command, argument))
        except ConnectionError as error:
            raise DeviceError(f"its window is gone ({self._last_output()})") from error
        self._unanswered = True

    def post(self, command: str, argument: object) -> None:
        """Send a scheduled command, whose answer `receive` returns once it was executed. Raises DeviceError."""
        self.tell(command, argument, _SHOW_TIMEOUT_S)
        self._unanswered = False

    def answered(self) -> bool:
        """Whether an answer can be read without waiting, or the child is gone."""
        return self._connection.poll(0)

    def settle(self, timeout_s: float) -> Any:
        """Wait for the answer to the last command, if it is outstanding, and return its value. Raises DeviceError."""
        unanswered, self._unanswered = self._unanswered, False
        return self.receive(timeout_s) if unanswered else None

    def ask(self, command: str, argument: object, timeout_s: float) -> Any:
        """Send a command and return the answer's value. Raises DeviceError."""
        self.tell(command, argument, timeout_s)
        return self.settle(timeout_s)

    def end(self) -> None:
        """Close the connection and kill the process, without waiting for pyglet to clean up."""
        self._connection.close()
        self._process.kill()
        self._process.wait()
        self._log.close()

    def _last_output(self) -> str:
        self._process.wait(timeout=_SHOW_TIMEOUT_S)
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        return " ".join(lines[-2:]) if lines else f"exit code {self._process.returncode}"


def _display(named: str | None = None) -> str:
    if named is not None:
        return f"the display {named!r}"
    return f"the display {os.environ['DISPLAY']!r}" if os.environ.get("DISPLAY") else "no display (DISPLAY is not set)"


def list_screens() -> list[Screen]:
    """All screens of the desktop. Raises DeviceError if there is no desktop, or if pyglet is missing."""
    process = _WindowProcess()
    try:
        screens: list[Screen] = process.receive(_START_TIMEOUT_S)
    except DeviceError as error:
        raise DeviceError(f"screens cannot be listed on {_display()}: {error}") from error
    finally:
        process.end()
    return screens


class ScreenProjector(AbstractContextManager["ScreenProjector"]):
    """A projector that is a screen of this computer, from opening to closing (a context manager).

    `wanted`: the screen's number, name or geometry; None for the only one of its size; or an X display, for the only
    one there. `size`: (width, height) of the images that it shows, in square pixels; `grid`: its own pixels. Raises
    DeviceError if there is no such screen, if it has another size, or if it does not show pixels unchanged.
    """

    def __init__(self, wanted: int | str | None, size: tuple[int, int], grid: PixelGrid = SQUARE_PIXELS) -> None:
        self.size = size
        self._grid = grid
        display = display_of(wanted)
        self._name = f"projector on {_display(display)}"
        self._process = _WindowProcess(display)
        try:
            with self._errors():
                screens: list[Screen] = self._process.receive(_START_TIMEOUT_S)
            self.screen = choose_screen(
                [replace(screen, display=display) for screen in screens],
                None if display else wanted,
                grid.device_size(size),
            )
            self._name = f"projector on {self.screen}"
            with self._errors():
                self.renderer = str(self._process.ask("open", self.screen, _START_TIMEOUT_S))
        except BaseException:
            self._process.end()
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    def prepare(self, image: Image) -> None:
        """Start drawing an (H, W) 8-bit grey image into the back buffer, without waiting.

        Raises ValueError if the image has another size, DeviceError if the window or its X server is gone.
        """
        pixels = self._sampled(image)
        with self._errors():
            self._process.tell("prepare", pixels, _SHOW_TIMEOUT_S)

    def flip(self) -> Swap:
        """Show the prepared image; returns when the graphics card has swapped buffers. Raises DeviceError."""
        with self._errors():
            return Swap(*self._process.ask("flip", None, _SHOW_TIMEOUT_S))

    def show_at(self, image: Image, when_s: float) -> None:
        """Schedule an image for `when_s` of the monotonic clock, or as soon as possible after it; does not wait.

        Raises ValueError if the image has another size, DeviceError if the window or its X server is gone.
        """
        pixels = self._sampled(image)
        with self._errors():
            self._process.post("show at", (pixels, when_s))

    def shown(self, *, wait: bool) -> Swap | None:
        """The oldest swap of `show_at` that was not returned yet. Without `wait`, None if none has happened.

        Raises DeviceError.
        """
        with self._errors():
            return Swap(*self._process.receive(_SHOW_TIMEOUT_S)) if wait or self._process.answered() else None

    def show(self, image: Image) -> None:
        """Prepare and flip."""
        self.prepare(image)
        self.flip()

    def close(self) -> None:
        """Close the window."""
        self._process.end()

    def _sampled(self, image: Image) -> Image:
        """What its own pixels show of an image."""
        width, height = self.size
        if image.shape != (height, width) or image.dtype != np.uint8:
            raise ValueError(f"expected an 8-bit grey image of {width} × {height}, found {image.dtype} {image.shape}")
        return self._grid.sample(image)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except DeviceError as error:
            raise DeviceError(
                f"{self._name}: {error}. Check that the desktop runs and that the projector is on, then rerun."
            ) from error
