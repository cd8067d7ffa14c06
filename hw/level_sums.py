"""Pictures that prove each other: together they light every place alike, as a picture and its inverse do.

Of frames that show what they should, the sum over such pictures is level. A frame that holds a share of the picture
before or after it, or shows another one altogether, makes the differences between neighbours show in that sum.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Image

_MOST_PIXELS = 20_000
_LEAST_TOLERANCE = 0.015
_MOST_TERMS = 10  # differences between neighbours, times frames in the sum, of two or four frames
_LEAST_DIFFERENCE = 0.25  # of neighbours, rms; that of black and white is nothing but noise

_UNEVEN = 0.35  # rms of a sum; lenses and bounced light make 0.1 of right frames, and pictures that do not fit 0.5


@dataclass(frozen=True)
class LevelSums:
    """Judges frames at pixels (N,) that the projector lights: `dark` (N,) and `contrast` (N,) are of black and white.

    `tolerance`: the largest share of another picture that is not told from noise.
    """

    pixels: tuple[np.ndarray, np.ndarray]
    dark: Floats
    contrast: Floats
    tolerance: float

    def seen(self, image: Image) -> Floats:
        """Brightness (N,) in a frame: 0 where black looks like this, 1 where white does."""
        return (_grey(image[self.pixels]) - self.dark) / self.contrast

    def foreign_share(self, group: Sequence[int], pictures: Sequence[Image], seen: Mapping[int, Floats]) -> float:
        """About which share of a frame is of another picture than its own, which light every place alike together.

        `group`: their numbers in the series of all frames, of which `seen` has these and those next to them. What of
        the sum, where it is not level, the differences between neighbours explain (least squares); those are none
        where a picture stayed too long, so a sum that is far from level counts as it is. How a picture looks that is
        black or white everywhere is known.
        """
        plain = [
            abs(float(seen[number].mean()) - picture[0, 0] / 255)
            for number, picture in zip(group, pictures, strict=True)
            if picture.min() == picture.max()
        ]
        changes = sorted({(first, first + 1) for number in group for first in (number - 1, number)})
        steps = np.stack([seen[to] - seen[of] for of, to in changes if of in seen and to in seen], axis=1)
        steps -= steps.mean(axis=0)
        total = np.sum([seen[number] for number in group], axis=0)
        explained = steps @ np.linalg.lstsq(steps, total - total.mean(), rcond=1e-3)[0]
        largest = float(np.sqrt(np.mean(steps**2, axis=0).max()))
        share = float(np.sqrt(np.mean(explained**2))) / max(largest, _LEAST_DIFFERENCE)
        uneven = float(total.std())
        return float(max([share, uneven if uneven > _UNEVEN else 0.0, *plain]))


def level_sums(dark: Sequence[Image], bright: Sequence[Image], lit: np.ndarray, tolerance: float) -> LevelSums:
    """From frames of black and of white at rest, and the pixels (H, W) that tell them apart."""
    rows, columns = np.nonzero(lit)
    chosen = np.random.default_rng(0).permutation(len(rows))[:_MOST_PIXELS]
    pixels = rows[chosen], columns[chosen]
    levels = [np.stack([_grey(image[pixels]) for image in images]) for images in (dark, bright)]
    contrast = levels[1].mean(axis=0) - levels[0].mean(axis=0)
    # Noise is in a frame and in its differences to others alike, which looks as if they had to do with each other.
    variance = float(np.mean(np.diff(levels[1], axis=0) ** 2 / 2 / contrast**2))
    by_chance = 3 * np.sqrt(_MOST_TERMS * variance / len(chosen)) / _LEAST_DIFFERENCE
    noise = 4 * variance + by_chance
    return LevelSums(pixels, levels[0].mean(axis=0), contrast, max(_LEAST_TOLERANCE, tolerance) + float(noise))


def _grey(pixels: Image) -> Floats:
    """Pixels (N,) or, of colour cameras, (N, 3) → their brightness (N,)."""
    return pixels.mean(axis=1) if pixels.ndim == 2 else pixels.astype(np.float64)
