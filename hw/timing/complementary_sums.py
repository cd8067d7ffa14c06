"""Pictures that prove each other: together they light every place alike, as a picture and its inverse do.

Of frames that show what they should, the sum over such pictures is level. A frame that holds a share of the picture
before or after it, or shows another one altogether, makes the differences between neighbours show in that sum.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Image

_MOST_PAIRS = 10_000
_APART = 75  # of the width of an image: how far pixels of a pair are apart at most; at least two and three pixels
_LEAST_TOLERANCE = 0.015
_MOST_TERMS = 10  # differences between neighbours, times frames in the sum, of two or four frames
_LEAST_DIFFERENCE = 0.15  # of neighbours, rms; that of black and white is nothing but noise

_ALIKE = 0.2  # differences that differ by no more, relative to the largest, do so by noise
# What is no sum of such pictures at all: rms, and brightness of each. Lenses and bounced light make 0.1 in sums of
# right frames, pictures that do not fit 0.5. A pair is 0.5 bright, down to 0.35 of fine stripes, and so is a fringe,
# by the projector's response.
_UNEVEN, _DARKEST, _BRIGHTEST = 0.35, 0.2, 0.7
_CROSSED = 0.1  # of correlations of steps; where the camera sees but few periods, right ones may be off by 0.03


@dataclass(frozen=True)
class ComplementarySums:
    """Judges frames at pixels (N,) that the projector lights: `dark` (N,) and `contrast` (N,) are of black and white.

    The second half of all pixels are each near their counterpart in the first.

    `tolerance`: the largest share of another picture that is not told from noise. `variance`: of the noise, in squares
    of the contrast, halfway between black and white.
    """

    pixels: tuple[np.ndarray, np.ndarray]
    dark: Floats
    contrast: Floats
    tolerance: float
    variance: float

    def seen(self, image: Image) -> Floats:
        """Brightness (N,) in a frame: 0 where black looks like this, 1 where white does."""
        return (_grey(image[self.pixels]) - self.dark) / self.contrast

    def foreign_share(
        self,
        group: Sequence[int],
        pictures: Sequence[Image],
        seen: Mapping[int, Floats],
        beside: Mapping[int, Collection[int]],
    ) -> float:
        """About which share of a frame is of another picture than its own, which light every place alike together.

        `group`: their numbers in the series of all frames, steps of a fringe in their order; `seen` has these and those
        that were on the wall `beside` each. What of the sum, where it is not level, the differences between neighbours
        explain; those are none where a picture stayed too long, so a sum that is far from level, or too dark, is not
        theirs at all. How a picture looks that is black or white everywhere is known.
        """
        plain = [
            abs(float(seen[number].mean()) - picture[0, 0] / 255)
            for number, picture in zip(group, pictures, strict=True)
            if _is_plain(picture)
        ]
        total = np.sum([seen[number] for number in group], axis=0)
        if total.std() > _UNEVEN or not _DARKEST < total.mean() / len(group) < _BRIGHTEST:
            return 1.0
        crossed = _crossed_share([seen[number] for number in group])
        return float(max([self._share(group, seen, beside, total), crossed, *plain]))

    def changed_share(
        self,
        group: Sequence[int],
        pictures: Sequence[Image],
        before: Mapping[int, Floats],
        seen: Mapping[int, Floats],
        beside: Mapping[int, Collection[int]],
    ) -> float:
        """By about which share frames that were taken again are not what they were before.

        What is the scene's own does not change; another picture's light is another one's the next time. `beside`: what
        was on the wall before and after each, either time. Between black and white there is nothing but how bright they
        are.
        """
        shares = []
        for number, picture in zip(group, pictures, strict=True):
            change = seen[number] - before[number]
            shares += [self._share((number,), seen, beside, change)]
            shares += [abs(float(change.mean()))] if _is_plain(picture) else []
        return max(shares)

    def _share(
        self,
        group: Sequence[int],
        seen: Mapping[int, Floats],
        beside: Mapping[int, Collection[int]],
        values: Floats,
    ) -> float:
        """Of the differences between frames and those beside them, the largest share that is in values (N,).

        Each by itself, as if nothing else was: relative to the largest one, that of a faint difference would seem small
        (a fine fringe that follows a coarse one). And all together (least squares), for shares of several. Noise that
        is in the values and in a difference alike is taken off.
        """
        changes = sorted({(min(one, other), max(one, other)) for one in group for other in beside[one]})
        changes = [(of, to) for of, to in changes if of in seen and to in seen]
        if not changes:
            return 0.0
        steps = np.stack([seen[to] - seen[of] for of, to in changes])
        steps -= steps.mean(axis=1, keepdims=True)
        sizes = steps.std(axis=1)
        told = sizes > _LEAST_DIFFERENCE
        if not told.any():
            return 0.0
        values = values - values.mean()
        noise = self.variance * np.array([(to in group) - (of in group) for of, to in changes])
        single = np.abs(steps @ values / values.size - noise)[told] / sizes[told] ** 2
        return float(max(single.max(), _explained(steps[told], values).std() / sizes.max()))


def _is_plain(picture: Image) -> bool:
    """Whether it is alike everywhere."""
    return bool(picture.min() == picture.max())


def _crossed_share(steps: Sequence[Floats]) -> float:
    """What the sum of a fringe's steps (N,), an even number of them, does not tell: that two are late by the same
    share, half a period from each other, as the pictures before them are.

    The difference of two such steps goes with that of others as the cosine of what lies between them; then it does not.
    """
    half = len(steps) // 2
    if half < 2 or len(steps) % 2:
        return 0.0
    differences = np.stack(steps[:half]) - np.stack(steps[half:])
    differences -= differences.mean(axis=1, keepdims=True)
    found = differences @ differences.T
    expected = np.cos(np.pi / half * np.subtract.outer(np.arange(half), np.arange(half)))
    off = np.abs(found / found.max() - expected)[np.triu_indices(half, 1)].max()
    return float(off) if off > _CROSSED else 0.0


def _explained(terms: Floats, values: Floats) -> Floats:
    """What terms (T, N) explain of values (N,): least squares, by the normal equations, for there are few terms and
    many values; terms that nearly depend on others count for nothing.
    """
    squares, directions = np.linalg.eigh(terms @ terms.T)
    kept = squares > _ALIKE**2 * squares[-1]
    along = (terms @ values) @ directions[:, kept] / squares[kept]
    found: Floats = (directions[:, kept] @ along) @ terms
    return found


def complementary_sums(
    dark: Sequence[Image], bright: Sequence[Image], lit: np.ndarray, tolerance: float
) -> ComplementarySums:
    """From frames of black and of white at rest, and the pixels (H, W) that tell them apart."""
    pixels = _pairs(lit)
    levels = [np.stack([_grey(image[pixels]) for image in images]) for images in (dark, bright)]
    contrast = levels[1].mean(axis=0) - levels[0].mean(axis=0)
    # Noise is in a frame and in its differences to others alike, which looks as if they had to do with each other.
    variances = [float(np.mean(np.diff(frames, axis=0) ** 2 / 2 / contrast**2)) for frames in levels]
    by_chance = 6 * np.sqrt(_MOST_TERMS * variances[1] / len(pixels[0]))
    tolerance = max(_LEAST_TOLERANCE, tolerance) + float(4 * variances[1] + by_chance)
    return ComplementarySums(pixels, levels[0].mean(axis=0), contrast, tolerance, float(np.mean(variances)))


def _pairs(lit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of pixels that are lit (H, W), then of one near each, in any direction, that is lit, too."""
    rng = np.random.default_rng(0)
    rows, columns = np.nonzero(lit)
    chosen = rng.permutation(len(rows))[:_MOST_PAIRS]
    first = np.stack([rows[chosen], columns[chosen]])
    angle = 2 * np.pi * rng.random(len(chosen))
    apart = rng.uniform(2, max(3.0, lit.shape[1] / _APART), len(chosen))
    second = first + np.rint(apart * np.stack([np.sin(angle), np.cos(angle)])).astype(np.int64)
    inside = np.all((second >= 0) & (second < np.array(lit.shape)[:, None]), axis=0)
    inside[inside] = lit[tuple(second[:, inside])]
    if not inside.any():  # there is hardly any light: pixels count twice, and there is nothing between them
        return np.tile(first[0], 2), np.tile(first[1], 2)
    found = np.concatenate([first[:, inside], second[:, inside]], axis=1)
    return found[0], found[1]


def _grey(pixels: Image) -> Floats:
    """Pixels (N,) or, of colour cameras, (N, 3) → their brightness (N,)."""
    return pixels.mean(axis=1) if pixels.ndim == 2 else pixels.astype(np.float64)
