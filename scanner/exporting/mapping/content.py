"""The picture that all projectors show together: a rectangle on the largest wall, seen straight on or from one eye."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.geometry import Size
from calib.numerics import Floats, compiled
from scanner.errors import InputError
from scanner.exporting.mapping.projector_view import Numbers, WallPart
from scanner.exporting.mapping.scene import WallView

_LARGEST_PX = 16_384


@dataclass(frozen=True, eq=False)
class Content:
    """A rectangle on a wall: its lower left corner `low` (2,) along the wall's axes, its width and height `extent`.

    `size`: of the picture, in square pixels. `viewpoint`: from where it is undistorted.
    """

    viewpoint: WallView
    low: Floats
    extent: tuple[float, float]
    size: Size

    @property
    def origin(self) -> Floats:
        """The lower left corner (3,)."""
        wall = self.viewpoint.wall
        corner: Floats = wall.axes @ self.low + wall.offset * wall.normal
        return corner

    def coordinates(self, on_wall: Numbers) -> Numbers:
        """Places on the wall (n, W, 2) → shares of width and height from the lower left corner, and 1, (n, W, 3); zeros
        where the content does not reach.
        """
        places = np.empty((*on_wall.shape[:2], 3), np.float32)
        _locate(on_wall.reshape(-1, 2), self.low, np.array(self.extent), places.reshape(-1, 3))
        return places


def content_on(viewpoint: WallView, parts: Sequence[WallPart]) -> Content:
    """The smallest rectangle that holds all that is lit of the wall, with pixels as fine as the finest projector's.

    Raises InputError if no projector lights it.
    """
    finest = min((part.pixel for part in parts if np.isfinite(part.pixel)), default=0.0)
    if finest <= 0:
        raise InputError("no projector lights the largest wall, so there is nothing to show a picture on")
    low, high = np.min([part.low for part in parts], axis=0), np.max([part.high for part in parts], axis=0)
    step = max(finest, float(np.max(high - low)) / _LARGEST_PX)
    width, height = (max(1, int(np.ceil(side / step))) for side in high - low)
    return Content(viewpoint, low, (width * step, height * step), Size(width, height))


@compiled
def _locate(on_wall: Numbers, low: Floats, extent: Floats, places: Numbers) -> None:
    for i in range(len(on_wall)):
        x, y = (on_wall[i, 0] - low[0]) / extent[0], (on_wall[i, 1] - low[1]) / extent[1]
        is_inside = (x >= 0.0) & (x <= 1.0) & (y >= 0.0) & (y <= 1.0)
        places[i, 0], places[i, 1], places[i, 2] = (x, y, 1.0) if is_inside else (0.0, 0.0, 0.0)
