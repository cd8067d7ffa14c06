"""A calibration over time as small plots, one for each parameter, that fit into a panel."""

from collections.abc import Iterator, Sequence
from datetime import timedelta

import numpy as np
from markupsafe import Markup, escape

from calib.numerics import Floats
from scanner.rendering import even_ticks, tick_text
from scanner.results import LOGGED, LogEntry, LoggedParameter, differences

_WIDTH, _HEIGHT = 340.0, 84.0  # of a plot, in pixels of the panel
_LEFT, _RIGHT, _TOP, _BOTTOM = 50.0, 8.0, 22.0, 6.0
_ACROSS, _DOWN = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
_MIDDLE = _TOP + _DOWN / 2
_DATES = 18.0
_COLOURS = ("#3b82c4", "#d07a1f", "#3c9a5f")  # of x, y and z, legible on light and on dark
_CHANGED = "#cc4a4a"
_TICKS, _ROOM = 5, 1.15
_LEAST = {"%": 0.01, "px": 0.1, "°": 0.001}  # half of the range that a plot has at least


def history_svg(entries: Sequence[LogEntry]) -> Markup:
    """Each parameter's difference from the first entry with its standard deviation, over time; '' without entries.

    A line marks where the calibration before did not hold.
    """
    if not entries:
        return Markup("")
    at = _places(entries)
    parts, top = [], 0.0
    for parameter in LOGGED:
        curves = list(differences(entries, parameter))
        if curves and any(np.isfinite(values).any() for values, _ in curves):
            parts.append(f'<g transform="translate(0 {top:.0f})">{_plot(entries, at, parameter, curves)}</g>')
            top += _HEIGHT
    first, last = entries[0].date, entries[-1].date
    style = "%Y-%m-%d %H:%M" if last - first < timedelta(days=2) else "%Y-%m-%d"
    dates = ((_LEFT, "start", first), (_WIDTH - _RIGHT, "end", last))
    parts += [_text(x, top + 12, f"{date.astimezone():{style}}", anchor) for x, anchor, date in dates[: len(entries)]]
    return Markup(
        f'<svg role="img" aria-label="the calibration over time" viewBox="0 0 {_WIDTH:.0f} {top + _DATES:.0f}" '
        'style="width: 100%; display: block; font: 12px sans-serif" fill="currentColor">' + "".join(parts) + "</svg>"
    )


def _places(entries: Sequence[LogEntry]) -> Floats:
    """Where the entries are along the axis of time, in pixels, (N,)."""
    seconds = np.array([entry.date.timestamp() for entry in entries])
    span = float(seconds.max() - seconds.min())
    share = (seconds - seconds.min()) / span if span else np.linspace(0.0, 1.0, len(entries))
    inset = 6.0  # points at the ends are whole
    return np.asarray(_LEFT + inset + (_ACROSS - 2 * inset) * share, np.float64)


def _plot(
    entries: Sequence[LogEntry], at: Floats, parameter: LoggedParameter, curves: Sequence[tuple[Floats, Floats]]
) -> str:
    extents = [np.abs(values) + sigmas for values, sigmas in curves]
    half = _ROOM * max(float(np.nanmax(extents)), _LEAST[parameter.unit])
    parts = [_text(_LEFT, 14, parameter.label, "start", "bold"), _newest(parameter, curves)]
    for tick in even_ticks(-half, half, _TICKS):
        y = _MIDDLE - _DOWN / 2 * tick / half
        opacity = 0.5 if tick == 0 else 0.15
        parts.append(_line(_LEFT, _WIDTH - _RIGHT, y, y, f'stroke="currentColor" stroke-opacity="{opacity}"'))
        parts.append(_text(_LEFT - 5, y + 4, tick_text(tick), "end"))
    for entry, x in zip(entries, at.tolist(), strict=True):
        if not entry.holds:
            style = f'stroke="{_CHANGED}" stroke-dasharray="3 2" stroke-width="1.5"'
            parts.append(f"<g><title>{escape(entry.change)}</title>{_line(x, x, _TOP, _TOP + _DOWN, style)}</g>")
    for (values, sigmas), colour in zip(curves, _COLOURS, strict=False):
        there = np.isfinite(values)
        scale = _DOWN / 2 / half
        parts += _curve(at[there], _MIDDLE - scale * values[there], scale * sigmas[there], colour)
    return "".join(parts)


def _curve(x: Floats, y: Floats, bar: Floats, colour: str) -> Iterator[str]:
    """Points (N,) with their standard deviations, and a line through them."""
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    yield f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.2"/>'
    for a, b, half in zip(x.tolist(), y.tolist(), bar.tolist(), strict=True):
        yield _line(a, a, b - half, b + half, f'stroke="{colour}" stroke-width="2" stroke-opacity="0.6"')
        yield f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2.5" fill="{colour}"/>'


def _line(x1: float, x2: float, y1: float, y2: float, style: str) -> str:
    return f'<line x1="{x1:.1f}" x2="{x2:.1f}" y1="{y1:.1f}" y2="{y2:.1f}" {style}/>'


def _newest(parameter: LoggedParameter, curves: Sequence[tuple[Floats, Floats]]) -> str:
    """The newest values, in the colours of their curves, at the right above the plot."""
    spans = []
    for name, colour, (values, _) in zip(parameter.axes, _COLOURS, curves, strict=False):
        value = f"{values[-1]:+.2g}".replace("-", "−") if np.isfinite(values[-1]) else "–"
        value = "0" if values[-1] == 0 else value
        spans.append(f'<tspan fill="{colour}">{f"{name} " if name else ""}{value}</tspan>')
    unit = parameter.unit if parameter.unit == "°" else f" {parameter.unit}"
    return f'<text x="{_WIDTH - _RIGHT}" y="14" text-anchor="end">{"  ".join(spans)}{unit}</text>'


def _text(x: float, y: float, text: str, anchor: str, weight: str = "normal") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-weight="{weight}">{escape(text)}</text>'
