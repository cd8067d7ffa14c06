"""Which camera sees whose light, as a graph in inline SVG: cameras at the left, projectors at the right."""

from collections.abc import Sequence

from markupsafe import Markup, escape

from scanner.networks.sights import PairProgress
from scanner.quantities import percent
from scanner.rendering import BLUE, VERMILION, css_colour
from scanner.shown_text import shortened

# One unit is one pixel where the graph is narrowest.
_LETTER, _LONGEST_NAME, _GAP, _DOT = 8, 14, 10, 6
_ROW, _NARROWEST = 72, 220
# Labels are on their edges, those of a projector below each other, so near the cameras that no two of them meet.
_FIRST, _PITCH, _FARTHEST = 44, 54, 0.6
_LABEL_HEIGHT = 18


def network_graph(sights: Sequence[PairProgress]) -> Markup:
    """Draw an edge for each pair, as wide as the part of its picture that the camera sees; dashed until that is known.

    `sights` are of at least one pair. A page may give its colours as `--page`, `--accent` and `--second`.
    """
    cameras = list(dict.fromkeys(sight.camera for sight in sights))
    projectors = list(dict.fromkeys(sight.projector for sight in sights))
    left, right = (_margin(names) for names in (cameras, projectors))
    width = left + right + max(_NARROWEST, round((_FIRST + _PITCH * (len(projectors) - 1)) / _FARTHEST))
    height = _ROW * max(len(cameras), len(projectors))
    places = {name: (left, _row(cameras, name, height)) for name in cameras}
    places |= {name: (width - right, _row(projectors, name, height)) for name in projectors}
    edges, labels = [], []
    for sight in sights:
        (x, y), (to_x, to_y) = places[sight.camera], places[sight.projector]
        before = _FIRST + _PITCH * projectors.index(sight.projector)
        edges.append(
            f'<line x1="{x}" y1="{y:.1f}" x2="{to_x}" y2="{to_y:.1f}" {_stroke(sight)}>'
            f"<title>{escape(_sentence(sight))}</title></line>"
        )
        labels.append(_label(x + before, y + before * (to_y - y) / (to_x - x), _state(sight)))
    for name, (x, y) in places.items():
        edges.append(f'<circle cx="{x}" cy="{y:.1f}" r="{_DOT}"/>')
        beside, anchor = (x - _GAP, "end") if name in cameras else (x + _GAP, "start")
        labels.append(_text(beside, y, shortened(name, _LONGEST_NAME), anchor))
    return Markup(
        f'<svg role="img" aria-label="{escape(". ".join(map(_sentence, sights)))}" viewBox="0 0 {width} {height}" '
        f'style="display: block; min-width: {width}px; max-width: {1.2 * width:.0f}px" font-size="14" '
        f'fill="currentColor">{"".join([*edges, *labels])}</svg>'
    )


def _margin(names: Sequence[str]) -> int:
    return 2 * _GAP + _LETTER * min(_LONGEST_NAME, max(map(len, names)))


def _row(names: Sequence[str], name: str, height: float) -> float:
    return height * (names.index(name) + 0.5) / len(names)


def _stroke(sight: PairProgress) -> str:
    if sight.failure:
        return f'style="stroke: var(--second, {css_colour(VERMILION)})" stroke-width="2" stroke-dasharray="2 4"'
    if sight.share is not None:
        return f'style="stroke: var(--accent, {css_colour(BLUE)})" stroke-width="{1 + 9 * sight.share:.1f}"'
    return f'stroke="currentColor" stroke-width="{2 if sight.done else 1}" stroke-dasharray="5 5" stroke-opacity="0.6"'


def _state(sight: PairProgress) -> str:
    """In one word."""
    if sight.failure:
        return "✕"
    if sight.share is not None:
        return percent(sight.share)
    return f"{sight.done}/{sight.total}" if sight.done else "…"


def _sentence(sight: PairProgress) -> str:
    return f"{sight.name}: {sight.text}"


def _label(x: float, y: float, text: str) -> str:
    width = _LETTER * len(text)
    corner = f'x="{x - width / 2:.1f}" y="{y - _LABEL_HEIGHT / 2:.1f}"'
    behind = f'<rect {corner} width="{width}" height="{_LABEL_HEIGHT}" rx="4" style="fill: var(--page, Canvas)"/>'
    return behind + _text(x, y, text, "middle")


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" dy="0.35em" text-anchor="{anchor}">{escape(text)}</text>'
