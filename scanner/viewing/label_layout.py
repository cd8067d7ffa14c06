"""Where labels go in a window so that none lies over another."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.numerics import Floats
from scanner.viewing.geometry import WindowView

Anchor = Literal[
    "top-left",
    "top-center",
    "top-right",
    "center-left",
    "center-center",
    "center-right",
    "bottom-left",
    "bottom-center",
    "bottom-right",
]
# As viser draws them: 12 pixels high, a little wider than they are in most fonts.
LETTER_PX, LINE_PX, _PADDING_PX = 6.9, 18.0, 6.0
# The part of its width and height that a label has left of, and above, the point that it is at.
_BEFORE = {"left": 0.0, "center": 0.5, "right": 1.0, "top": 0.0, "bottom": 1.0}
_ANCHORS: tuple[Anchor, ...] = (
    "center-left",
    "center-right",
    "top-center",
    "bottom-center",
    "bottom-left",
    "bottom-right",
    "top-left",
    "top-right",
)


@dataclass(frozen=True)
class TextLabel:
    """A `text` at a `place` (3,) of the cloud's frame; `anchor` is the side of it that is there if there is room."""

    text: str
    place: Floats
    anchor: Anchor


def arranged(labels: Sequence[TextLabel], view: WindowView) -> tuple[Anchor | None, ...]:
    """The anchor of each label, so that none lies over another or is cut off; None for one that finds no room.

    The first have their choice first. A label that the window does not show is as it wants to be.
    """
    if not labels:
        return ()
    pixels, depths = view.project(np.stack([label.place for label in labels]))
    taken: list[Floats] = []
    anchors: list[Anchor | None] = []
    for label, pixel, depth in zip(labels, pixels, depths, strict=True):
        if depth <= 0 or np.any(pixel < 0) or np.any(pixel > (view.width, view.height)):
            anchors.append(label.anchor)
            continue
        inside = [
            (anchor, area)
            for anchor, area in _areas(label, pixel, view.density)
            if _is_inside(area, view) and not any(_overlap(area, other) for other in taken)
        ]
        anchors.append(inside[0][0] if inside else None)
        taken += [area for _, area in inside[:1]]
    return tuple(anchors)


def area_of(text: str, pixel: Floats, anchor: Anchor, density: int = 1) -> Floats:
    """Left, top, right and bottom of a label at a pixel, (4,)."""
    size = density * np.array([LETTER_PX * len(text) + _PADDING_PX, LINE_PX])
    vertical, horizontal = anchor.split("-")
    low = pixel - size * (_BEFORE[horizontal], _BEFORE[vertical])
    return np.concatenate([low, low + size])


def _areas(label: TextLabel, pixel: Floats, density: int) -> Iterator[tuple[Anchor, Floats]]:
    for anchor in dict.fromkeys((label.anchor, *_ANCHORS)):
        yield anchor, area_of(label.text, pixel, anchor, density)


def _overlap(first: Floats, second: Floats) -> bool:
    return bool(np.all(first[:2] < second[2:]) and np.all(second[:2] < first[2:]))


def _is_inside(area: Floats, view: WindowView) -> bool:
    return bool(np.all(area[:2] >= 0) and np.all(area[2:] <= (view.width, view.height)))
