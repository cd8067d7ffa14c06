"""A diagram as an SVG file on a card of its own, light or dark as the reader's system is."""

from collections.abc import Sequence
from html import escape

Point = tuple[float, float]

_LETTER_PX = 7.4  # of 13 px; no usual font is wider in the mean
_LINE_PX = 17.0
_LIGHT = "--paper:#fff;--ink:#222;--quiet:#666;--fill:#f1f1ee;--a:#0072b2;--b:#d55e00;--c:#00795a;--shade:0.16"
_DARK = "--paper:#1e2129;--ink:#e8e8e8;--quiet:#a5a8b0;--fill:#2b2f3a;--a:#56b4e9;--b:#f09a4a;--c:#3fc79a;--shade:0.28"
_STYLE = (
    f"svg{{{_LIGHT}}}@media(prefers-color-scheme:dark){{svg{{{_DARK}}}}}"
    "text{font:13px system-ui,sans-serif;fill:var(--ink)}.bold{font-weight:600}.quiet{fill:var(--quiet)}"
    ".box{fill:var(--fill);stroke:var(--quiet)}.line{fill:none;stroke:var(--ink);stroke-width:1.5}"
    ".thin{fill:none;stroke:var(--quiet);stroke-width:1}.dash{fill:none;stroke:var(--quiet);stroke-dasharray:4 4}"
    + "".join(
        f".{name}{{fill:var(--{name});fill-opacity:var(--shade);stroke:var(--{name});stroke-width:1.5}}"
        f".{name}-line{{fill:none;stroke:var(--{name});stroke-width:2}}text.{name}{{fill-opacity:1;stroke:none}}"
        for name in "abc"
    )
)
_HEAD = (
    '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    '<path d="M0,0L8,4L0,8z" style="fill:var(--ink)"/></marker>'
)


class Drawing:
    """Shapes in pixels, y down. Styles: `a` camera, `b` projector, `c` scene, and `box`, `line`, `thin`, `dash`."""

    def __init__(self, width: float, height: float, title: str, description: str) -> None:
        self._width = width
        self._head = (
            '<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-labelledby="t d" '
            f'viewBox="0 0 {width:g} {height:g}">'
            f'<title id="t">{escape(title)}</title><desc id="d">{escape(description)}</desc>'
            f"<style>{_STYLE}</style><defs>{_HEAD}</defs>"
            f'<rect width="{width:g}" height="{height:g}" rx="8" style="fill:var(--paper)"/>'
        )
        self._parts: list[str] = []

    def __str__(self) -> str:
        return self._head + "\n".join(self._parts) + "</svg>\n"

    def text(self, x: float, y: float, words: str, style: str = "", anchor: str = "start") -> None:
        """A line of text, whose baseline is at y. Raises ValueError if it would leave the card."""
        before = {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor] * len(words) * _LETTER_PX
        if x - before < 0 or x - before + len(words) * _LETTER_PX > self._width:
            raise ValueError(f"{words!r} leaves the card")
        self._parts.append(
            f'<text x="{x:g}" y="{y:g}" class="{style}" text-anchor="{anchor}">{escape(words, quote=False)}</text>'
        )

    def box(
        self, x: float, y: float, width: float, height: float, lines: Sequence[str] = (), style: str = "box"
    ) -> None:
        """A rounded box with centred lines, the first in bold. Raises ValueError if one does not fit."""
        self._parts.append(f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="5" class="{style}"/>')
        top = y + (height - _LINE_PX * len(lines)) / 2 + 13
        for number, line in enumerate(lines):
            if len(line) * _LETTER_PX > width or _LINE_PX * len(lines) > height:
                raise ValueError(f"{line!r} does not fit its box")
            bold = "bold" if number == 0 else "quiet"
            self.text(x + width / 2, top + number * _LINE_PX, line, bold, "middle")

    def line(self, points: Sequence[Point], style: str = "line", *, arrow: bool = False) -> None:
        """An open line, with a head at its last point if it is an arrow."""
        head = ' marker-end="url(#head)"' if arrow else ""
        self._parts.append(f'<polyline points="{_listed(points)}" class="{style}"{head}/>')

    def area(self, points: Sequence[Point], style: str) -> None:
        """A filled polygon."""
        self._parts.append(f'<polygon points="{_listed(points)}" class="{style}"/>')

    def circle(self, centre: Point, radius: float, style: str) -> None:
        """A filled circle."""
        self._parts.append(f'<circle cx="{centre[0]:g}" cy="{centre[1]:g}" r="{radius:g}" class="{style}"/>')


def _listed(points: Sequence[Point]) -> str:
    return " ".join(f"{round(x, 1):g},{round(y, 1):g}" for x, y in points)
