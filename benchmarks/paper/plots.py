"""Curves and heat maps of the page, as standalone SVG files."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, log10

import numpy as np

from scanner.rendering import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    Pixels,
    between,
    css_colour,
    png_of,
    shaded,
)
from scanner.reporting import HEIGHT, WIDTH, Plot, Scale

_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, SKY_BLUE, ORANGE)
_LEGEND_PX, _PER_LETTER_PX, _SAMPLE_PX = 24, 7.0, 22
_MARGIN = 16  # right margin, for half of the last tick's label
_PANEL, _GAP, _HEAD, _FOOT = 150, 14, 40, 46
_SHADES = between((59, 76, 192), (221, 221, 221), (180, 4, 38))  # Moreland 2009
NO_POINT = "."  # a missing value of a heat map
_FONT = "font-family: system-ui, sans-serif; font-size: 13px; fill: #222;"
_STYLE = (
    f"text {{ {_FONT} }} polyline {{ fill: none; stroke-width: 2; stroke-linejoin: round; }} "
    ".axis { stroke: #222; stroke-width: 0.8; } .grid { stroke: #222; stroke-width: 0.6; stroke-opacity: 0.14; } "
    f".bound {{ stroke: {css_colour(BLACK)}; stroke-dasharray: 5 4; }} "
    f".published {{ stroke: {css_colour(GREY)}; stroke-dasharray: 2 3; }} "
    + " ".join(f".s{i} {{ stroke: {css_colour(colour)}; }}" for i, colour in enumerate(_COLOURS))
)


@dataclass(frozen=True)
class Axis:
    """Label of a plot's horizontal axis, and whether it is logarithmic."""

    label: str
    log: bool = False


Points = Sequence[tuple[float, float | None]]


def curves(axis: Axis, vertical: str, lines: Mapping[str, Points], alt: str, kinds: Mapping[str, str]) -> str:
    """Lines by name over a logarithmic vertical axis; `kinds` gives styles ('bound', 'published', 's0' …).

    A missing or non-positive value leaves a gap in the line.
    """
    known = [(x, y) for points in lines.values() for x, y in points if y is not None and y > 0]
    horizontal = _spanning([x for x, _ in known], axis.label, log=axis.log)
    plot = Plot(horizontal, _decades([y for _, y in known], vertical), alt)
    styles = _styles(lines, kinds)
    for name, points in lines.items():
        for run in _unbroken(points):
            x, y = np.array(run, np.float64).T
            plot.line(x, y, styles[name])
    return _standalone(str(plot.svg()), [(name, styles[name]) for name in lines])


def _styles(lines: Mapping[str, Points], kinds: Mapping[str, str]) -> dict[str, str]:
    plain = [name for name in lines if name not in kinds]
    return {name: kinds.get(name) or f"s{plain.index(name) % len(_COLOURS)}" for name in lines}


def _unbroken(points: Points) -> list[list[tuple[float, float]]]:
    runs: list[list[tuple[float, float]]] = [[]]
    for x, y in points:
        if y is not None and y > 0:
            runs[-1].append((x, y))
        else:
            runs.append([])
    return [run for run in runs if len(run) > 1]


def _spanning(values: list[float], label: str, *, log: bool) -> Scale:
    low, high = min(values), max(values)
    return Scale(low, high if high > low else low + 1, label, log)


def _decades(values: list[float], label: str) -> Scale:
    """Whole decades around all values."""
    low, high = (10.0 ** rounded(log10(value)) for rounded, value in ((floor, min(values)), (ceil, max(values))))
    return Scale(low, high if high > low else 10 * low, label, log=True)


def _standalone(svg: str, legend: list[tuple[str, str]]) -> str:
    """An inline plot as a file, on white, with a legend below it."""
    x, y, parts = 0.0, HEIGHT + _LEGEND_PX / 2, []
    for name, style in legend:
        width = 2 * _SAMPLE_PX + _PER_LETTER_PX * len(name)
        if x + width > WIDTH:
            x, y = 0.0, y + _LEGEND_PX
        parts.append(
            f'<polyline class="{style}" points="{x + 8:.0f},{y - 4:.0f} {x + 8 + _SAMPLE_PX:.0f},{y - 4:.0f}"/>'
        )
        parts.append(f'<text x="{x + 14 + _SAMPLE_PX:.0f}" y="{y:.0f}">{escape(name)}</text>')
        x += width
    return _framed(WIDTH + _MARGIN, round(y + _LEGEND_PX / 2), svg + "".join(parts), "")


def heat_maps(panels: Mapping[str, Sequence[str]], titles: Mapping[str, str], alt: str) -> str:
    """Maps of signed µm, rows of numbers, with a common colour scale, each below its name and title."""
    maps = {name: _grid(panel) for name, panel in panels.items()}
    limit = max(1.0, float(np.nanpercentile(np.abs(np.concatenate([grid.ravel() for grid in maps.values()])), 98)))
    width = _GAP + len(maps) * (_PANEL + _GAP)
    parts = []
    for number, (name, grid) in enumerate(maps.items()):
        x = _GAP + number * (_PANEL + _GAP)
        middle = x + _PANEL / 2
        parts.append(f'<text x="{middle:.0f}" y="16" text-anchor="middle">{escape(name)}</text>')
        parts.append(f'<text x="{middle:.0f}" y="33" text-anchor="middle">{escape(titles[name])}</text>')
        parts.append(_picture(_coloured(grid, limit), x, _HEAD, _PANEL, _PANEL))
    bottom = _HEAD + _PANEL + 10
    bar = np.broadcast_to(_SHADES[None], (4, len(_SHADES), 3))
    parts.append(_picture(np.ascontiguousarray(bar), _GAP, bottom, _PANEL, 10))
    parts.append(f'<text x="{_GAP}" y="{bottom + 26}">−{limit:.0f} µm</text>')
    parts.append(f'<text x="{_GAP + _PANEL}" y="{bottom + 26}" text-anchor="end">+{limit:.0f} µm</text>')
    return _framed(width, _HEAD + _PANEL + _FOOT, "".join(parts), alt)


def _grid(panel: Sequence[str]) -> np.ndarray:
    return np.array([[np.nan if value == NO_POINT else float(value) for value in row.split()] for row in panel])


def _coloured(grid: np.ndarray, limit: float) -> Pixels:
    colours = shaded(np.nan_to_num(np.clip(grid / (2 * limit) + 0.5, 0, 1)), _SHADES)
    colours[np.isnan(grid)] = 255
    return colours


def _picture(colours: Pixels, x: float, y: float, width: float, height: float) -> str:
    opaque = np.dstack([colours, np.full(colours.shape[:2], 255, np.uint8)])
    data = b64encode(png_of(opaque)).decode("ascii")
    return (
        f'<image x="{x:.0f}" y="{y:.0f}" width="{width:.0f}" height="{height:.0f}" preserveAspectRatio="none" '
        f'style="image-rendering: pixelated" href="data:image/png;base64,{data}"/>'
    )


def _framed(width: int, height: int, inside: str, alt: str) -> str:
    label = f' role="img" aria-label="{escape(alt)}"' if alt else ""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg"{label} width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}"><style>{_STYLE}</style>'
        f'<rect width="{width}" height="{height}" fill="#fff"/>{_sized(inside)}</svg>\n'
    )


def _sized(inside: str) -> str:
    """An inline plot takes its size from its page; inside another picture it needs one."""
    return inside.replace(
        '<svg class="plot"', f'<svg class="plot" overflow="visible" width="{WIDTH}" height="{HEIGHT}"', 1
    )
