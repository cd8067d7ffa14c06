"""The camera's image in the large area of the page for as long as that shows no cloud: fitted in, or pixel by pixel."""

from dataclasses import dataclass
from threading import Lock
from typing import Any

import cv2
import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image as PilImage
from PIL import ImageDraw, ImageFont

from calib.numerics import Floats, Image
from scanner.console.picture import shown
from scanner.rendering import Pixels
from scanner.viewing import Window, Windows

_ZOOM_PX = 8.0  # of the window for a pixel of the camera
_BACKGROUND, _INK, _FADED = 24, (235, 235, 235), (150, 150, 150)
_MARGIN, _PLOT, _LINE, _FONT_PX = 12, (256, 72), 19, 14


@dataclass(frozen=True)
class Placement:
    """Where an image is in a window: pixel (x, y) of it, from its top left corner, is at `scale` (x, y) + `corner`."""

    scale: float
    corner: Floats

    @classmethod
    def of(
        cls, image_size: tuple[int, int], free: tuple[int, int], centre: Floats | None = None, density: int = 1
    ) -> "Placement":
        """Fitted into the `free` part of the window, (width, height) from its top left; or with `centre` (2,), a pixel
        of the image, in the middle of that, so large that single pixels are seen; `density` as of `WindowView`.
        """
        sizes = np.array(image_size, float), np.array(free, float)
        fitting = float(np.min(sizes[1] / sizes[0]))
        scale = fitting if centre is None else max(density * _ZOOM_PX, 2 * fitting)
        return cls(scale, sizes[1] / 2 - scale * (sizes[0] / 2 if centre is None else centre))

    def pixel_at(self, place: Floats) -> Floats:
        """The image's pixel at a place (2,) of the window."""
        pixel: Floats = (place - self.corner) / self.scale
        return pixel


@dataclass(frozen=True)
class Shown:
    """What is to be shown: the `image`, the camera's `highest_level`, whether to `mark` what is clipped or dark, the
    lines of text below it, and its `counts` of grey levels, (n,).
    """

    image: Image
    highest_level: int
    mark: bool
    lines: tuple[str, ...]
    counts: Floats


def painted(
    content: Shown, size: tuple[int, int], free: tuple[int, int], centre: Floats | None, density: int = 1
) -> Pixels:
    """The picture of a window of `size` (width, height), (height, width, 3) RGB; the rest as of `Placement`."""
    image = content.image
    place = Placement.of((image.shape[1], image.shape[0]), free, centre, density)
    canvas = np.full((size[1], size[0], 3), _BACKGROUND, np.uint8)
    # Of an image that is larger than the window only what is in it is drawn.
    low = np.clip(np.floor(place.pixel_at(np.zeros(2))), 0, None).astype(int)
    high = np.ceil(place.pixel_at(np.array(free, float))).astype(int)
    part = image[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]
    if part.size:
        drawn = np.maximum(1, np.rint(place.scale * np.array(part.shape[1::-1]))).astype(int)
        smaller = min(int(drawn.max()), max(part.shape[:2]))
        reduced = shown(
            part, content.highest_level, mark_clipped=content.mark, mark_dark=content.mark, longest_side=smaller
        )
        _paste(
            canvas[: free[1], : free[0]],
            np.asarray(cv2.resize(reduced, drawn.tolist(), interpolation=cv2.INTER_NEAREST), np.uint8),
            np.rint(place.corner + place.scale * low).astype(int),
        )
    return _labelled(canvas, content, free, density)


def _paste(canvas: Pixels, picture: Pixels, corner: NDArray[np.int64]) -> None:
    left, top = np.maximum(corner, 0)
    x, y = np.maximum(-corner, 0)
    fitting = picture[y : y + max(0, canvas.shape[0] - top), x : x + max(0, canvas.shape[1] - left)]
    canvas[top : top + fitting.shape[0], left : left + fitting.shape[1]] = fitting


def _labelled(canvas: Pixels, content: Shown, free: tuple[int, int], density: int) -> Pixels:
    """With the histogram and the lines at the lower left of the free part."""
    (width, height), line, margin = (density * length for length in _PLOT), density * _LINE, density * _MARGIN
    font = ImageFont.load_default(density * _FONT_PX)
    heights = np.log1p(content.counts) / max(float(np.log1p(content.counts.max(initial=0.0))), 1e-9) * height
    picture = PilImage.fromarray(canvas)
    draw = ImageDraw.Draw(picture)
    left, bottom = margin, free[1] - margin - line * len(content.lines)
    step = width / max(1, len(heights))
    text_width = max((draw.textlength(text, font) for text in content.lines), default=0.0)
    box = (left - 6, bottom - height - 6, left + max(width, text_width) + 6, free[1] - margin + 4)
    draw.rectangle(box, (_BACKGROUND,) * 3)
    for number, tall in enumerate(heights):
        draw.rectangle((left + number * step, bottom - tall, left + (number + 1) * step - 1, bottom), _FADED)
    for number, text in enumerate(content.lines):
        draw.text((left, bottom + 2 + number * line), text, _INK, font)
    return np.asarray(picture)


class LargeImage:
    """In all windows that show no cloud. A click shows single pixels of the camera there, another one the whole."""

    def __init__(self, scene: viser.SceneApi, windows: Windows) -> None:
        self._windows = windows
        self._lock = Lock()
        self._content: Shown | None = None
        self._centres: dict[int, Floats] = {}
        scene.on_click()(self._clicked)

    def show(self, content: Shown) -> None:
        """Show it in place of the last one."""
        with self._lock:
            self._content = content
            self._windows.paint(self._painted)

    def _painted(self, window: Window) -> Pixels | None:
        if self._content is None or min(window.free) < 1:
            return None
        return painted(
            self._content, window.size, window.free, self._centres.get(window.client.client_id), window.density
        )

    def _clicked(self, event: viser.SceneClickEvent) -> Any:
        window = self._windows.of(event.client)
        with self._lock:
            if self._content is None or window is None or window.view is not None:
                return
            if self._centres.pop(event.client_id, None) is None:
                height, width = self._content.image.shape[:2]
                place = Placement.of((width, height), window.free)
                pixel = place.pixel_at(np.array(event.screen_pos) * window.size)
                if np.any(pixel < 0) or np.any(pixel > (width, height)):
                    return
                self._centres[event.client_id] = pixel
            self._windows.paint(self._painted)
