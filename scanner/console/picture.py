"""A camera's frame for the eye: reduced, its clipped pixels marked, its grey levels counted; fitted into the large area
of the page or pixel by pixel, for as long as that shows no cloud.
"""

from dataclasses import dataclass
from threading import Lock
from typing import Any

import cv2
import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image as PilImage
from PIL import ImageDraw, ImageFont

from calib.numerics import Bools, Floats, Image
from scanner.decoding import saturation_level
from scanner.rendering import BLUE, Pixels, reduced_size
from scanner.viewing import Window, Windows

# Okabe and Ito's vermilion: told from every grey by every kind of colour vision.
CLIPPED_COLOUR = (213, 94, 0)
DARK_COLOUR = BLUE
HISTOGRAM_BINS = 64
_SHARP_SIDE, _MOST = 1024, 0.5
_LONGEST_SIDE = 720
_DARK_SHARE = 0.02
_ZOOM_PX = 8.0  # of the window for a pixel of the camera
_BACKGROUND, _INK, _FADED = 24, (235, 235, 235), (150, 150, 150)
_MARGIN, _PLOT, _LINE, _FONT_PX = 12, (256, 72), 19, 14


@dataclass(frozen=True)
class Exposed:
    """The exposure of a frame: `clipped` and `dark` are shares of its pixels; `median` is a share of the full scale."""

    clipped: float
    dark: float
    median: float


def clipped_pixels(image: Image, highest_level: int) -> Bools:
    """Which pixels (H, W) are clipped, in any channel; JPEG-like spreading in 8 bits is allowed for."""
    level = float(highest_level) if image.dtype != np.uint8 else min(saturation_level(image), float(highest_level))
    return np.asarray(_brightest(image) >= level)


def dark_pixels(image: Image, highest_level: int) -> Bools:
    """Which pixels (H, W) are dark in every channel: under 2 % of the camera's highest level."""
    return np.asarray(_brightest(image) < _DARK_SHARE * highest_level)


def sharpness(image: Image) -> float:
    """How much finest detail the middle of a picture has, as a share of its brightness: comparable for one scene only.

    0 for a picture without light.
    """
    bright = _brightest(image)
    top, left = (max(0, (length - _SHARP_SIDE) // 2) for length in bright.shape)
    middle = bright[top : top + _SHARP_SIDE, left : left + _SHARP_SIDE].astype(np.float32)
    mean = float(middle.mean())
    # Smoothed, because noise is as fine.
    detail = cv2.Laplacian(cv2.GaussianBlur(middle, (0, 0), 1.0), cv2.CV_32F)
    return float(np.sqrt(np.mean(detail**2))) / mean if mean > 0 else 0.0


def exposed(image: Image, highest_level: int) -> Exposed:
    """Clipped: at the camera's highest level. Dark: under 2 % of it."""
    bright = _brightest(image)
    return Exposed(
        float(np.mean(clipped_pixels(image, highest_level))),
        float(np.mean(dark_pixels(image, highest_level))),
        float(np.median(bright)) / highest_level,
    )


def histogram(image: Image, highest_level: int) -> tuple[Floats, Floats]:
    """Middles of equal ranges of grey levels, in per cent of all, and how many pixels are in each, (64,) both."""
    counts, edges = np.histogram(_brightest(image), HISTOGRAM_BINS, range=(0, highest_level + 1))
    middles: Floats = 100 * (edges[:-1] + edges[1:]) / 2 / (highest_level + 1)
    return middles, counts.astype(np.float64)


def shown(
    image: Image, highest_level: int, *, mark_clipped: bool, mark_dark: bool = False, longest_side: int = _LONGEST_SIDE
) -> NDArray[np.uint8]:
    """RGB, reduced to a `longest_side`, brightness as the camera has it; clipped pixels in `CLIPPED_COLOUR` if wanted,
    dark ones in `DARK_COLOUR`.

    A mark is as large as a pixel of the reduced picture at least, so that no clipped pixel is lost in it. Dark is what
    most pixels there are.
    """
    size = reduced_size(image.shape[1], image.shape[0], longest_side)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32) * np.float32(255 / highest_level)
    grey = np.rint(np.minimum(small, np.float32(255))).astype(np.uint8)
    rgb = np.asarray(cv2.cvtColor(grey, cv2.COLOR_BGR2RGB if grey.ndim == 3 else cv2.COLOR_GRAY2RGB), np.uint8)
    if mark_dark:
        dark = dark_pixels(image, highest_level).astype(np.float32)
        rgb[np.asarray(cv2.resize(dark, size, interpolation=cv2.INTER_AREA)) > _MOST] = DARK_COLOUR
    if mark_clipped:
        clipped = clipped_pixels(image, highest_level).astype(np.float32)
        rgb[np.asarray(cv2.resize(clipped, size, interpolation=cv2.INTER_AREA)) > 0] = CLIPPED_COLOUR
    return rgb


def _brightest(image: Image) -> Image:
    return image if image.ndim == 2 else image.max(axis=2)


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
