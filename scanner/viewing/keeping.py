"""Buttons that keep the view: as it is, at twice its size, or as a turn."""

from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from scanner.errors import InputError
from scanner.viewing.buttons import PLAIN
from scanner.viewing.colouring import ColourBar
from scanner.viewing.geometry import WindowView, turned
from scanner.viewing.pictures import TURN_STEPS, Margin, completed, gif, png
from scanner.viewing.scene import CloudScene
from scanner.viewing.view_controls import failures_shown
from scanner.viewing.windows import Window

_TWICE, _TRIAL = 2.0, 0.1
_TURN_PX = 720  # longest side of a turn: a file that can be sent
_PATIENCE_S = 120.0  # a browser without a graphics card takes seconds for a picture


class Keeping:
    """Buttons in the GUI container that is open on creation; `legend` gives the title and the bar of the colours."""

    def __init__(
        self, gui: viser.GuiApi, scene: CloudScene, name: str, legend: Callable[[], tuple[str, ColourBar | None]]
    ) -> None:
        self._scene, self._name, self._legend = scene, name, legend
        with gui.add_folder("Keep the view", expand_by_default=False):
            self._buttons = {
                "view.png": gui.add_button("Picture, twice its size (PNG)", color=PLAIN),
                "turn.gif": gui.add_button("A turn around it (GIF)", color=PLAIN),
            }
            self._message = gui.add_markdown("")
        for ending, button in self._buttons.items():
            button.on_click(self._keeping(ending, {"view.png": self._picture, "turn.gif": self._turn}[ending]))

    def _keeping(self, ending: str, make: Callable[[Window], bytes]) -> Callable[[viser.GuiEvent[Any]], None]:
        def keep(event: viser.GuiEvent[Any]) -> None:
            window = None if event.client is None else self._scene.windows.of(event.client)
            if event.client is None or window is None or window.view is None:
                return
            self._disable(disabled=True)
            self._message.content = "The browser draws …"
            try:
                with failures_shown(self._message):
                    content, file = make(window), f"{self._name}-{ending}"
                    event.client.send_file_download(file, content, save_immediately=True)
                    self._message.content = f"Saved as {ending}, {len(content) / 1e6:.1f} MB."
            finally:
                self._disable(disabled=False)
                window.follow()

        return keep

    def _disable(self, *, disabled: bool) -> None:
        for button in self._buttons.values():
            button.disabled = disabled

    def _picture(self, window: Window) -> bytes:
        view = window.view
        if view is None:
            raise InputError("there is nothing to take a picture of any more")
        with self._scene.enlarged(_TWICE):
            _drawn(
                window, view, _TRIAL
            )  # the size of the points goes another way to the browser than the order to draw
            return png(completed(_drawn(window, view, _TWICE), self._margin(window, view), _TWICE, view.density))

    def _turn(self, window: Window) -> bytes:
        view, viewpoint = window.view, window.viewpoint
        if view is None or viewpoint is None:
            raise InputError("there is nothing to turn any more")
        size = min(1.0, _TURN_PX / max(view.width, view.height))
        pictures: list[Image.Image] = []
        with self._scene.enlarged(size):
            _drawn(window, view, _TRIAL)
            for step in range(TURN_STEPS):
                place = turned(viewpoint, 2 * np.pi * step / TURN_STEPS)
                seen_from = WindowView.towards(place, view.fov_rad, view.width, view.height)
                window.arrange(seen_from)
                pictures.append(
                    completed(_drawn(window, seen_from, size), self._margin(window, view), size, view.density)
                )
                self._message.content = f"The browser draws: {step + 1} of {TURN_STEPS} …"
        return gif(pictures)

    def _margin(self, window: Window, view: WindowView) -> Margin:
        title, bar = self._legend()
        return Margin(window.scale_of(view), title, bar)


def _drawn(window: Window, view: WindowView, size: float) -> NDArray[np.uint8]:
    """What the window's browser draws from there, (H, W, 4) RGBA, `size` times as large. Raises InputError."""
    try:
        picture = window.client.get_render(
            round(size * view.height),
            round(size * view.width),
            wxyz=Rotation.from_matrix(view.axes.T).as_quat(scalar_first=True),
            position=window.drawn_position(view),
            fov=view.fov_rad,
            transport_format="png",
            timeout=_PATIENCE_S,
        )
    except (RuntimeError, TimeoutError) as error:
        raise InputError(
            "the browser drew no picture: keep its window open and in front until the file is there"
        ) from error
    return np.asarray(picture, np.uint8)
