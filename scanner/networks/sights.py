"""How far the capture of each pair is, and how much of its picture each camera sees in each projector's light; as a
graph in inline SVG, cameras at the left, projectors at the right.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from math import prod
from types import TracebackType
from typing import TypeVar

from markupsafe import Markup, escape

from hw.rig import Frame
from scanner.networks.captures import Pair
from scanner.quantities import percent
from scanner.rendering import BLUE, VERMILION, css_colour
from scanner.results import Decoded
from scanner.shown_text import shortened
from scanner.ui import Progress

T = TypeVar("T")
# One unit is one pixel where the graph is narrowest.
_LETTER, _LONGEST_NAME, _GAP, _DOT = 8, 14, 10, 6
_ROW, _NARROWEST = 72, 220
# Labels are on their edges, those of a projector below each other, so near the cameras that no two of them meet.
_FIRST, _PITCH, _FARTHEST = 44, 54, 0.6
_LABEL_HEIGHT = 18


@dataclass(frozen=True)
class PairProgress:
    """A camera in a projector's light, of which `done` of `total` frames are taken."""

    camera: str
    projector: str
    total: int = 0
    done: int = 0
    share: float | None = None
    """Of the camera's pixels, those that are matched; None until the capture is decoded."""
    failure: str = ""
    """Why there is no capture, '' if there may be one."""

    @classmethod
    def of(cls, pair: Pair, capture: Decoded) -> "PairProgress":
        """What a decoded capture shows."""
        count = len(capture.metadata.patterns)
        return cls(*pair, count, count, len(capture.matches) / prod(capture.metadata.camera_size))

    @property
    def name(self) -> str:
        """Which pair it is."""
        return in_light(self.camera, self.projector)

    @property
    def text(self) -> str:
        """Its state in words."""
        if self.failure:
            return f"failed: {self.failure}"
        if self.share is not None:
            return f"{percent(self.share)} of its picture"
        return f"{self.done} of {self.total} frames" if self.done else "waiting"


def in_light(camera: str, projector: str) -> str:
    """A pair in words."""
    return f"{camera} in the light of {projector}"


OnSight = Callable[[PairProgress, Frame | None], object]  # with the frame that has just been taken, if one has


def nobody(_: PairProgress, __: Frame | None) -> None:
    """Does nothing."""


class Watched(AbstractContextManager["Watched"]):
    """The captures of pairs that are taken together: `scanner.ui.Progress` that passes on to another, and tells
    `on_sight` of each frame.

    It tells also of an error that ends its `with` block, to which it adds whose captures these were.
    """

    def __init__(self, pairs: Sequence[Pair], progress: Progress, on_sight: OnSight) -> None:
        self._sights = {pair: PairProgress(*pair) for pair in pairs}
        self._progress, self._on_sight = progress, on_sight

    def track(self, items: Iterable[T], total: int, _: str) -> Iterator[T]:
        """Pass `items` on, and tell how many went by, and of which pairs in place of what is done with them."""
        for done, item in enumerate(self._progress.track(items, total, self._names), start=1):
            for sight, frame in zip([*self._sights.values()], frames_in(item), strict=False):
                self._tell(replace(sight, done=done, total=total), frame)
            yield item

    def step(self, what: str) -> AbstractContextManager[None]:
        """Tell what is being done."""
        return self._progress.step(what)

    def decoded(self, pair: Pair, capture: Decoded) -> None:
        """All of it is known."""
        self._tell(PairProgress.of(pair, capture))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is not None:
            error.add_note(f"This was {self._names}.")
            for sight in [*self._sights.values()]:
                if sight.share is None:
                    self._tell(replace(sight, failure=str(error) or type(error).__name__))

    @property
    def _names(self) -> str:
        cameras, projectors = (" and ".join(dict.fromkeys(names)) for names in zip(*self._sights, strict=True))
        return in_light(cameras, projectors)

    def _tell(self, sight: PairProgress, frame: Frame | None = None) -> None:
        self._sights[sight.camera, sight.projector] = sight
        self._on_sight(sight, frame)


def frames_in(item: object) -> tuple[Frame, ...]:
    """The frames of (pattern, frame), as captures go by, or of one such for each camera; none of anything else."""
    if isinstance(item, tuple):
        return tuple(frame for part in item for frame in frames_in(part))
    return (item,) if isinstance(item, Frame) else ()


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
