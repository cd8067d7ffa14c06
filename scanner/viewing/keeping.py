"""Keeping the view: pictures of what a window has drawn, with scale bar and legend of the colours, and turns; and their
buttons.

A turn is a GIF: every browser, mail program and slide shows one, and what writes it is there anyway. The video that
OpenCV writes without further libraries is MPEG-4 part 2, which browsers refuse.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

from scanner.errors import InputError
from scanner.viewing.buttons import PLAIN
from scanner.viewing.colouring import ColourBar
from scanner.viewing.geometry import ScaleBar, WindowView, turned
from scanner.viewing.scene import CloudScene
from scanner.viewing.view_controls import failures_shown
from scanner.viewing.windows import Window

TURN_STEPS, _STEP_MS = 48, 80
_MARGIN, _TEXT, _BAR, _LEGEND_WIDTH, _GAP = 16, 13, 12, 260, 10
# Letters that Pillow's own font does not have.
_KNOWN = str.maketrans({"−": "-", "–": "-", "\u00a0": " ", "\u202f": " ", "×": "x", "µ": "u"})
_INK = (30, 30, 30)
_COLOURS = 256
_TWICE, _TRIAL = 2.0, 0.1
_TURN_PX = 720  # longest side of a turn: a file that can be sent
_PATIENCE_S = 120.0  # a browser without a graphics card takes seconds for a picture


@dataclass(frozen=True)
class Margin:
    """What is said beside a view: its `scale`, and the `title` and `bar` of its colours where they are numbers."""

    scale: ScaleBar
    title: str = ""
    bar: ColourBar | None = None


def completed(drawn: NDArray[np.uint8], margin: Margin, enlargement: float, density: int = 1) -> Image.Image:
    """Write scale bar and legend on what a window of a `density` has drawn, (H, W, 4) RGBA, on white.

    `enlargement`: how many times as large as the window the drawn picture is.
    """
    picture = Image.new("RGB", (drawn.shape[1], drawn.shape[0]), "white")
    rgba = Image.fromarray(drawn)
    picture.paste(rgba, mask=rgba.getchannel("A"))
    draw = ImageDraw.Draw(picture)
    of_text = enlargement * density
    font = ImageFont.load_default(_TEXT * of_text)

    def px(length: float) -> int:
        return round(length * of_text)

    line, width = px(_TEXT + 4), round(enlargement * margin.scale.width_px)
    left, top = px(_MARGIN), picture.height - px(_MARGIN) - line - px(6)
    corners = [(left, top), (left, top + px(6)), (left + width, top + px(6)), (left + width, top)]
    draw.line(corners, _INK, max(1, px(2)))
    text = margin.scale.text.translate(_KNOWN)
    draw.text((left + width / 2, top + px(8)), text, _INK, font, anchor="ma")
    if margin.bar is not None:
        _draw_legend(picture, margin.title, margin.bar, (left, top - px(_GAP) - 2 * line - px(_BAR)), of_text)
    return picture


def _draw_legend(picture: Image.Image, title: str, bar: ColourBar, at: tuple[int, int], enlargement: float) -> None:
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(_TEXT * enlargement)
    (left, top), line = at, round((_TEXT + 4) * enlargement)
    width, height = round(_LEGEND_WIDTH * enlargement), round(_BAR * enlargement)
    draw.text((left, top), title.translate(_KNOWN), _INK, font)
    shades = Image.fromarray(np.asarray(bar.shades, np.uint8)[None]).resize((width, height), Image.Resampling.BILINEAR)
    picture.paste(shades, (left, top + line))
    below = top + line + height + round(2 * enlargement)
    for text, share, anchor in ((bar.low, 0.0, "la"), (bar.middle, 0.5, "ma"), (bar.high, 1.0, "ra")):
        draw.text((left + share * width, below), text.translate(_KNOWN), _INK, font, anchor=anchor)


def png(picture: Image.Image) -> bytes:
    """The picture as the bytes of a PNG file."""
    file = BytesIO()
    picture.save(file, "PNG")
    return file.getvalue()


def gif(pictures: Iterable[Image.Image]) -> bytes:
    """Pictures of one size, one after the other and again, as the bytes of a GIF file; there has to be one."""
    first, *following = pictures
    # One palette for all: colours that changed from picture to picture would flicker.
    palette = first.quantize(_COLOURS)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in (first, *following)]
    file = BytesIO()
    frames[0].save(file, "GIF", save_all=True, append_images=frames[1:], duration=_STEP_MS, loop=0)
    return file.getvalue()


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
