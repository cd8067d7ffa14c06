"""`measure.png`: heat maps of the fitting errors, over the camera's pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from calib.numerics import Floats
from calib.pointcloud import NONE, grid_step, index_grid, without_gaps
from scanner.measuring.measurements import FitErrors, Measurements
from scanner.quantities import ShownUnit, shown_unit
from scanner.rendering import between, even_ticks, shaded

FIGURE_FILE = "measure.png"

_WIDTH, _HEIGHT = 704, 572  # of a panel
_LEFT, _TOP, _RIGHT, _BOTTOM = 70, 56, 134, 58  # around its map: for titles, ticks and the scale of colours
_BAR_AT, _BAR_WIDTH = 16, 20
_MOST_TICKS, _TICK = 8, 5
_TEXT, _TITLE = ImageFont.load_default(14), ImageFont.load_default(16)
_SHOWN_SHARE = 0.99
_SHADES = between((59, 76, 192), (221, 221, 221), (180, 4, 38))  # Moreland 2009
_NO_POINT = (217, 217, 217)
_MARGIN_OF_IMAGE = 0.15


@dataclass(frozen=True)
class _Panel:
    """A map of `errors` with two lines of title; `circle`: centre (x, y) and radius of a sphere's image."""

    title: str
    errors: Sequence[FitErrors]
    circle: tuple[float, float, float] | None = None


def write_figure(path: Path, measured: Measurements) -> None:
    """Draw a panel for each sphere and one for all faces; there has to be one of either. Raises OSError."""
    unit = shown_unit(measured.unit)
    panels = [
        _Panel(
            f"Sphere {number}: diameter {unit.length(sphere.diameter, sphere.diameter_budget.sigma)}\n"
            f"mean absolute error {unit.error(sphere.errors.mean_absolute)}",
            [sphere.errors],
            sphere.image_px,
        )
        for number, sphere in enumerate(measured.spheres, start=1)
    ]
    if measured.scene.faces:
        flatness = ", ".join(f"{face.name} {unit.number(face.errors.mean_absolute)}" for face in measured.scene.faces)
        title = f"Flatness of the faces: mean absolute errors\n{flatness} {unit.name}"
        panels.append(_Panel(title, [face.errors for face in measured.scene.faces]))
    figure = Image.new("RGB", (len(panels) * _WIDTH, _HEIGHT), "white")
    for number, panel in enumerate(panels):
        figure.paste(_drawn(panel, unit), (number * _WIDTH, 0))
    figure.save(path, "PNG")


@dataclass(frozen=True)
class _Frame:
    """Where a part of the camera's image, from pixel `low` (2,) to `high` (2,), is in a panel."""

    low: Floats
    high: Floats

    @property
    def scale(self) -> float:
        """Pixels of the panel for one of the camera's."""
        return float(np.min(np.array([_WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM]) / (self.high - self.low)))

    def place(self, x: float, y: float) -> tuple[int, int]:
        """Return the position of a camera pixel in the panel."""
        return round(_LEFT + self.scale * (x - self.low[0])), round(_TOP + self.scale * (y - self.low[1]))


def _drawn(panel: _Panel, unit: ShownUnit) -> Image.Image:
    """Signed distances in colour, on the part of the camera's image that has them."""
    residual = unit.factor * np.concatenate([part.residual for part in panel.errors])
    pixel = np.concatenate([part.pixel for part in panel.errors])
    (left, top), (right, bottom) = pixel.min(axis=0), pixel.max(axis=0)
    low, high = np.array([left - 0.5, top - 0.5]), np.array([right + 0.5, bottom + 0.5])
    step = grid_step(len(pixel), (right - left + 1, bottom - top + 1))
    cell = (pixel - (left, top)) // step
    index = without_gaps(index_grid(cell, cell.max(axis=0) + 1))
    limit = float(np.quantile(np.abs(residual), _SHOWN_SHARE)) or 1.0
    colours = shaded(np.clip(residual / (2 * limit) + 0.5, 0, 1), _SHADES)[index]
    colours[index == NONE] = _NO_POINT

    frame = _Frame(low, high)
    if panel.circle:
        x, y, radius = panel.circle
        reach = (1 + _MARGIN_OF_IMAGE) * radius
        frame = _Frame(np.array([x - reach, y - reach]), np.array([x + reach, y + reach]))
    image = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    drawing = ImageDraw.Draw(image)
    drawing.rectangle((*frame.place(*frame.low), *frame.place(*frame.high)), _NO_POINT)
    begin, end = frame.place(*low), frame.place(*high)
    size = max(1, end[0] - begin[0]), max(1, end[1] - begin[1])
    image.paste(Image.fromarray(colours).resize(size, Image.Resampling.NEAREST), begin)
    if panel.circle:
        drawing.ellipse((*frame.place(x - radius, y - radius), *frame.place(x + radius, y + radius)), outline="black")
    _draw_axes(drawing, frame)
    x_end, y_end = frame.place(*frame.high)
    drawing.multiline_text(((_LEFT + x_end) / 2, 8), panel.title, "black", _TITLE, "ma", align="center")
    _draw_scale(image, limit, f"{unit.name} off, + towards the camera", (x_end + _BAR_AT, y_end))
    return image


def _draw_axes(drawing: ImageDraw.ImageDraw, frame: _Frame) -> None:
    right, bottom = frame.place(*frame.high)
    drawing.rectangle((_LEFT, _TOP, right, bottom), outline="black")
    for tick in even_ticks(frame.low[0], frame.high[0], _MOST_TICKS):
        x, _ = frame.place(tick, 0)
        drawing.line((x, bottom, x, bottom + _TICK), "black")
        drawing.text((x, bottom + 2 * _TICK), f"{tick:.6g}", "black", _TEXT, "ma")
    for tick in even_ticks(frame.low[1], frame.high[1], _MOST_TICKS):
        _, y = frame.place(0, tick)
        drawing.line((_LEFT - _TICK, y, _LEFT, y), "black")
        drawing.text((_LEFT - 2 * _TICK, y), f"{tick:.6g}", "black", _TEXT, "rm")
    drawing.text(((_LEFT + right) / 2, bottom + 32), "camera column, px", "black", _TEXT, "ma")
    _draw_upwards(drawing, (12, (_TOP + bottom) // 2), "camera row, px")


def _draw_scale(image: Image.Image, limit: float, text: str, at: tuple[int, int]) -> None:
    """Draw the colour scale from −`limit` to `limit`; its lower left corner is `at`."""
    drawing = ImageDraw.Draw(image)
    left, bottom = at
    shades = Image.fromarray(np.ascontiguousarray(_SHADES[::-1, None])).resize((_BAR_WIDTH, bottom - _TOP))
    image.paste(shades, (left, _TOP))
    right = left + _BAR_WIDTH
    drawing.rectangle((left, _TOP, right, bottom), outline="black")
    for tick in even_ticks(-limit, limit, _MOST_TICKS):
        y = _TOP + (limit - tick) / (2 * limit) * (bottom - _TOP)
        drawing.line((right, y, right + _TICK, y), "black")
        drawing.text((right + 2 * _TICK, y), f"{tick:.6g}", "black", _TEXT, "lm")  # this font has no minus sign
    _draw_upwards(drawing, (right + 72, (_TOP + bottom) // 2), text)


def _draw_upwards(drawing: ImageDraw.ImageDraw, middle: tuple[int, int], text: str) -> None:
    """Text that reads from below, around its `middle`."""
    left, top, right, bottom = (round(edge) for edge in _TEXT.getbbox(text))
    written = Image.new("L", (right - left, bottom - top))
    ImageDraw.Draw(written).text((-left, -top), text, 255, _TEXT)
    turned = written.transpose(Image.Transpose.ROTATE_90)
    drawing.bitmap((middle[0] - turned.width // 2, middle[1] - turned.height // 2), turned, "black")
