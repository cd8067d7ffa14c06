"""The grid of a projector's pixels where they are not square or not in columns, as in diamond arrays of mirrors.

Everything else is told in square pixels, as high as the projector's are, or as wide if these are higher than wide. What
a pixel shows is the mean of a picture in square pixels over its area.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry.camera import Size
from calib.numerics import Floats, Image

_Values = Image | Floats


@dataclass(frozen=True)
class PixelGrid:
    """Pixels of equal size in rows; the usual one is of square pixels in columns."""

    aspect: float = 1.0
    """Height over width of a pixel: 0.5 for diamond arrays."""
    odd_rows: float = 0.0
    """How far odd rows, counted from 0 at the top, stand to the right of even ones, in widths of a pixel."""

    @property
    def square_per_pixel(self) -> tuple[float, float]:
        """Square pixels along x and along y in one of the projector's."""
        return max(1.0, 1 / self.aspect), max(1.0, self.aspect)

    def square_size(self, size: tuple[int, int]) -> Size:
        """The size of a picture in square pixels, of its size (width, height) in the projector's."""
        across, down = self.square_per_pixel
        return Size(round(size[0] * across), round(size[1] * down))

    def device_size(self, size: tuple[int, int]) -> Size:
        """The size of a picture in the projector's pixels, of its size (width, height) in square ones."""
        across, down = self.square_per_pixel
        return Size(round(size[0] / across), round(size[1] / down))

    def sample(self, picture: Image) -> Image:
        """What each of the projector's pixels shows (h, w), of an 8-bit picture in square pixels (H, W)."""
        if self == SQUARE_PIXELS:
            return picture
        (width, height), (across, down) = self.device_size(Size.of(picture)), self.square_per_pixel
        rows = _means_between(picture.T, down * np.arange(height + 1.0)).T
        sampled = np.empty((height, width), np.uint8)
        for first, aside in enumerate((0.0, self.odd_rows)):
            sampled[first::2] = np.rint(_means_between(rows[first::2], across * (np.arange(width + 1.0) + aside)))
        return sampled

    def spread(self, picture: Image) -> Image:
        """The light of a picture in the projector's pixels (h, w), at the centres of square ones (H, W)."""
        if self == SQUARE_PIXELS:
            return picture
        (width, height), (across, down) = self.square_size(Size.of(picture)), self.square_per_pixel
        row = ((np.arange(height) + 0.5) / down).astype(np.intp).clip(0, len(picture) - 1)
        aside = np.where(row % 2 == 1, self.odd_rows, 0.0)
        column = np.floor((np.arange(width) + 0.5) / across - aside[:, None]).astype(np.intp)
        light: Image = picture[row[:, None], column.clip(0, picture.shape[1] - 1)]
        return light


SQUARE_PIXELS = PixelGrid()


def _means_between(values: _Values, edges: Floats) -> Floats:
    """The means of lines (n, L) between successive edges, (n, E − 1); value i reaches from i to i + 1.

    What reaches beyond the ends of a line counts only inside.
    """
    length = values.shape[1]
    edges = np.clip(edges, 0, length)
    begins = np.minimum(edges.astype(np.intp), length - 1)
    sums = np.pad(np.cumsum(values, axis=1, dtype=np.float64), [(0, 0), (1, 0)])
    integral = sums[:, begins] + values[:, begins] * (edges - begins)
    means: Floats = np.diff(integral, axis=1) / np.diff(edges)
    return means
