"""The window on the projector's screen, in a process of its own; the only file that imports pyglet.

`hw/projector/process.py` starts `python -m hw.projector.pyglet_window FD`, and sends commands through the connection
FD. A separate process lets the scan survive the end of the X server, because Xlib then exits its process. It also has a
main thread of its own, which some systems require for windows.
"""

import signal
import sys
import time
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any

import numpy as np
import pyglet
from pyglet import gl

from hw.projector.screens import Screen

if TYPE_CHECKING:
    from calib.numerics import Image  # which loads a compiler: half of the time until the window opens

_IDLE_S = 0.05  # how often an idle window processes events
_PROBE_SEED = 1

# The shadow window queries GPU features, which are not needed here.
pyglet.options["shadow_window"] = False


def screens() -> list[Screen]:
    """All screens of the display, in the order of the desktop."""
    screens = []
    for number, screen in enumerate(pyglet.display.get_display().get_screens()):
        mode = screen.get_mode()
        name = str(screen.get_monitor_name())
        rate = float(mode.rate) if mode is not None and mode.rate else None  # virtual screens report 0
        screens.append(Screen(number, name, screen.x, screen.y, screen.width, screen.height, rate))
    return screens


class FullScreenWindow:
    """A window that covers a screen and shows images pixel by pixel.

    Raises ValueError if its place or size is wrong, or if it does not show pixels unchanged.
    """

    def __init__(self, screen: Screen) -> None:
        target = pyglet.display.get_display().get_screens()[screen.number]
        # No size is given, because pyglet would change the screen's mode to match it.
        self._window = pyglet.window.Window(fullscreen=True, screen=target, vsync=True, caption="projector")
        self._window.set_mouse_visible(False)
        self._screen = screen
        self._settle()
        self._check_place()
        self._check_pixels()

    @property
    def renderer(self) -> str:
        """The name of the graphics driver."""
        return str(self._window.context.get_info().get_renderer())

    @property
    def closed(self) -> bool:
        """Whether the operator has closed the window."""
        return bool(self._window.has_exit)

    def prepare(self, image: "Image") -> None:
        """Draw an (H, W) 8-bit image into the back buffer."""
        height, width = image.shape
        self._window.switch_to()
        self._window.dispatch_events()
        rgb = np.repeat(image[:, :, None], 3, axis=2).tobytes()
        pyglet.image.ImageData(width, height, "RGB", rgb, pitch=-3 * width).blit(0, 0)
        gl.glFinish()

    def flip(self) -> tuple[float, float]:
        """Show the prepared image; returns when the graphics card has swapped buffers.

        Returns the times before and after, in seconds of the monotonic clock.
        """
        begun_s = time.monotonic()
        self._window.flip()
        gl.glFinish()
        return begun_s, time.monotonic()

    def show_at(self, image: "Image", when_s: float) -> tuple[float, float]:
        """Prepare, and flip at `when_s` or when the image is drawn, if that is later; returns what `flip` does."""
        self.prepare(image)
        time.sleep(max(0.0, when_s - time.monotonic()))
        return self.flip()

    def show(self, image: "Image") -> None:
        """Prepare and flip."""
        self.prepare(image)
        self.flip()

    def look_after_events(self) -> None:
        """Process events, so that the window system does not consider the window hung."""
        self._window.switch_to()
        self._window.dispatch_events()

    def _settle(self) -> None:
        """Show a few pictures, until the window manager has placed the window."""
        black = np.zeros((self._screen.height, self._screen.width), np.uint8)
        for _ in range(5):
            self.show(black)

    def _check_place(self) -> None:
        expected = self._screen.geometry
        (width, height), (x, y) = self._window.get_size(), self._window.get_location()
        actual = f"{width}x{height}+{x}+{y}"
        if actual != expected:
            raise ValueError(f"the window should cover {expected}, but the window manager put it at {actual}")
        if self._window.get_framebuffer_size() != (width, height):
            raise ValueError("the desktop scales this screen: set its scale to 100 %")

    def _check_pixels(self) -> None:
        """Show noise and read it back, to find a driver that scales, filters or corrects colours."""
        size = (self._screen.height, self._screen.width)
        probe = np.random.default_rng(_PROBE_SEED).integers(0, 256, size).astype(np.uint8)
        self.show(probe)
        displayed = pyglet.image.get_buffer_manager().get_color_buffer().get_image_data().get_data("RGB", 3 * size[1])
        read_back = np.frombuffer(displayed, np.uint8).reshape(*size, 3)[::-1]
        if not np.array_equal(read_back, np.repeat(probe[:, :, None], 3, axis=2)):
            share = 100 * np.mean(np.any(read_back != probe[:, :, None], axis=2))
            raise ValueError(
                f"{share:.0f} % of the pixels were drawn wrongly: turn off scaling, night light and colour profiles"
            )


def _serve(connection: Connection) -> None:
    """Execute (command, argument) until the connection closes; answer each with ('done', value)."""
    connection.send(("done", screens()))
    command, screen = connection.recv()
    if command != "open":
        raise ValueError(f"expected the screen to open, found {command!r}")
    window = FullScreenWindow(screen)
    connection.send(("done", window.renderer))
    orders: SimpleQueue[tuple[str, Any]] = SimpleQueue()
    Thread(target=_listen, args=(connection, orders), daemon=True).start()
    while True:
        try:
            command, argument = orders.get(timeout=_IDLE_S)
        except Empty:
            window.look_after_events()
            continue
        if command == "end":
            return
        answer = _obey(window, command, argument)
        if window.closed:
            raise ValueError("the window was closed")
        connection.send(("done", answer))


def _listen(connection: Connection, orders: SimpleQueue[tuple[str, Any]]) -> None:
    """Receive commands while the window is busy, so that the sender does not have to wait."""
    try:
        while True:
            orders.put(connection.recv())
    except (EOFError, OSError):  # the scan has closed the connection
        orders.put(("end", None))


def _obey(window: FullScreenWindow, command: str, argument: Any) -> tuple[float, float] | None:
    if command == "prepare":
        window.prepare(argument)
        return None
    return window.flip() if command == "flip" else window.show_at(*argument)


def main(file_descriptor: int) -> None:
    """Serve the connection; report errors as ('failed', reason)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the scan handles Ctrl-C, and closes the connection
    with Connection(file_descriptor) as connection:
        try:
            _serve(connection)
        except EOFError:
            pass  # the scan has closed the connection
        except Exception as error:  # report every error to the scan
            connection.send(("failed", f"{error}" or type(error).__name__))


if __name__ == "__main__":
    main(int(sys.argv[1]))
