"""Pictures of the view to be kept: what a window has drawn, with scale bar and legend of the colours, and turns.

A turn is a GIF: every browser, mail program and slide shows one, and what writes it is there anyway. The video that
OpenCV writes without further libraries is MPEG-4 part 2, which browsers refuse.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from scanner.viewing.colouring import ColourBar
from scanner.viewing.scale_bar import ScaleBar

TURN_STEPS, _STEP_MS = 48, 80
_MARGIN, _TEXT, _BAR, _LEGEND_WIDTH, _GAP = 16, 13, 12, 260, 10
# Letters that Pillow's own font does not have.
_KNOWN = str.maketrans({"−": "-", "–": "-", "\u00a0": " ", "\u202f": " ", "×": "x", "µ": "u"})
_INK = (30, 30, 30)
_COLOURS = 256


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
    first, *others = pictures
    # One palette for all: colours that changed from picture to picture would flicker.
    palette = first.quantize(_COLOURS)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in (first, *others)]
    file = BytesIO()
    frames[0].save(file, "GIF", save_all=True, append_images=frames[1:], duration=_STEP_MS, loop=0)
    return file.getvalue()
