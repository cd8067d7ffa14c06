"""Samples of the frames, from which everything but the coordinates is measured: pixels at random, tiles, and a grid.

The camera's noise is measured from them. Some combinations of frames show the same light twice: every pattern plus its
inverse, white plus black, the mean of every fringe over its shifts. Their differences are noise. If a sequence has few
of them, the curvature of the frames along rows is used as well; edges of the scene do not move its median (after
Immerkær, CVIU 64, 1996).
"""

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from calib.numerics import SEED, Bools, Floats, Floats32, Image, Ints, Part, at_random, medians, robust_sigmas
from scanner.decoding.light.brightness import Gains
from scanner.decoding.light.exposures import BAYER_PX
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import FEW, FEWEST_PIXELS, MAJORITY

_MOST_PIXELS = 16384  # at random, so that a hundred are left in 1 % of the picture
TILE_PX, MOST_ALONG = 10, 24  # size of a tile; largest number of tiles along each side of the image
_MOST_OF_GRID = 224  # pixels along the longer side: smaller objects affect few matches


class Sample:
    """Grey levels of some pixels in the frames of a capture, each frame under a number.

    `pixels` (...): flat indices into an image of `shape` (H, W); everything per pixel has their shape. `beside`:
    samples of pixels next to these. `is_divided`: whether frames were scaled.
    """

    def __init__(self, shape: tuple[int, int], pixels: Ints, beside: Sequence["Sample"] = ()) -> None:
        self.shape, self.pixels, self.beside = shape, pixels, tuple(beside)
        self.rows: Ints = pixels // shape[1]
        self.is_divided = False
        self._frames: dict[int, NDArray[Any]] = {}

    @classmethod
    def at_random(cls, shape: tuple[int, int], *, neighbours: bool) -> Self:
        """Sample random pixels (P,), since a regular grid could beat with the fringes.

        With `neighbours` each pixel comes with one on its left and one on its right, of the same colour in a mosaic.
        """
        height, width = shape
        margin = BAYER_PX if neighbours and width > 2 * BAYER_PX else 0
        inner = width - 2 * margin
        row, column = np.divmod(at_random(height * inner, _MOST_PIXELS), inner)
        pixels = row * width + column + margin
        return cls(shape, pixels, [cls(shape, pixels + by) for by in (-margin, margin) if by])

    def of(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the pixels (...) of an image (H, W)."""
        return image.reshape(-1).take(self.pixels, mode="clip")  # all are inside; clip mode skips the bounds check

    def number_of(self, plan: SequencePlan, place: int) -> int | None:
        """Return the number of the frame at a place in the capture; None if it is not sampled."""
        # A repeated pattern is only used to detect changes since it was first shown.
        number = plan.shown[place]
        return number if plan.shown.index(number) == place else None

    def add(self, plan: SequencePlan, place: int, levels: NDArray[Any]) -> None:
        """Add the levels (...) of the frame at a place in the capture."""
        if (number := self.number_of(plan, place)) is not None:
            self._frames[number] = levels

    def has(self, *frames: int) -> bool:
        """Whether these frames have been added."""
        return self._frames.keys() >= {*frames}

    def level(self, frame: int) -> NDArray[Any]:
        """Return the grey levels (...) of a frame that has been added."""
        return self._frames[frame]

    def divide(self, frame: int, by: Floats) -> None:
        """Divide the grey levels of a frame by a factor of each pixel (...), or of all."""
        self._frames[frame] = (self._frames[frame] / by).astype(np.float32)
        self.is_divided = True
        for sample in self.beside:
            sample.divide(frame, by)

    def copy(self) -> Self:
        """Return a sample of the same frames, which may be divided by themselves."""
        copied = copy(self)
        copied.beside, copied._frames = tuple(sample.copy() for sample in self.beside), dict(self._frames)
        return copied

    def without(self, chosen: Bools) -> "Sample":
        """Return a sample without the chosen pixels (H, W)."""
        kept = ~self.of(chosen)
        remaining = Sample(self.shape, self.pixels[kept], [sample.without(chosen) for sample in self.beside])
        remaining._frames = {frame: levels[kept] for frame, levels in self._frames.items()}
        return remaining

    @property
    def as_taken(self) -> Image:
        """(frames, ...): grey levels as the camera gave them, as long as none is divided."""
        return np.stack([*self._frames.values()])

    @property
    def levels(self) -> Floats32:
        """(frames, ...): grey levels."""
        return np.stack([*self._frames.values()], dtype=np.float32)

    @property
    def curvature(self) -> Floats32 | None:
        """(frames, ...): left − 2 · centre + right, or None without neighbours."""
        if not self.beside:
            return None
        before, right = (sample.levels for sample in self.beside)
        return before - 2 * self.levels + right


class TileSample(Sample):
    """Square tiles on a regular grid over the image, tile by tile (P,)."""

    def __init__(self, shape: tuple[int, int]) -> None:
        (top, down, rows), (first_column, right, columns) = map(_tiles_along, shape)
        y = top + np.arange(rows)[:, None, None, None] * down + np.arange(TILE_PX)[:, None]
        x = first_column + np.arange(columns)[:, None, None] * right + np.arange(TILE_PX)
        super().__init__(shape, (y * shape[1] + x).reshape(-1))
        self.count = rows * columns
        self.static: Bools = np.ones(self.pixels.shape, np.bool_)

    def number_of(self, plan: SequencePlan, place: int) -> int | None:
        """Return the place, for fringes."""
        return place if plan.shown[place] in plan.fringe_frames else None

    def leave_out(self, moved: Bools) -> None:
        """Exclude the pixels of the image (H, W) where objects moved from the `static` ones (P,)."""
        self.static = ~cast(Bools, self.of(moved))

    @cached_property
    def camera_px(self) -> Floats:
        """(P, 2): camera coordinates of the pixels."""
        return np.stack([self.pixels - self.rows * self.shape[1], self.rows], axis=1).astype(np.float64)

    @cached_property
    def tile(self) -> Ints:
        """(P,): the tile number of each pixel."""
        return np.repeat(np.arange(self.count), TILE_PX**2)

    def of_frames(self, frames: Sequence[int], pixels: Ints | slice = slice(None)) -> Floats32:
        """(frames, pixels): grey levels of some frames, at all or some of the pixels."""
        return np.stack([self.level(frame)[pixels] for frame in frames], dtype=np.float32)


def _tiles_along(size: int) -> tuple[int, int, int]:
    """Return the start of the first tile along a side, their spacing, and their number; no tile fits a short side."""
    count = min(MOST_ALONG, size // TILE_PX)
    step = size // max(count, 1)
    return (size - count * step) // 2, step, count


class GridSample(Sample):
    """The image on a regular grid (h, w), to find where something moved and how large it is."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.step = max(1, -(-max(shape) // _MOST_OF_GRID))
        row, column = (np.arange(self.step // 2, size, self.step) for size in shape)
        super().__init__(shape, row[:, None] * shape[1] + column)

    def at_full_size(self, chosen: Bools) -> Bools:
        """Enlarge a mask of the grid (h, w) to the image (H, W), by nearest neighbour."""
        row, column = (
            np.minimum(np.arange(size) // self.step, count - 1)
            for size, count in zip(self.shape, chosen.shape, strict=True)
        )
        enlarged: Bools = chosen[row][:, column]
        return enlarged


@dataclass(frozen=True)
class Samples:
    """Samples of the frames of a capture."""

    scattered: Sample
    """Random pixels over the image; frames are numbered as in the plan."""
    tiles: TileSample
    """Of the frames of fringes, numbered in the order in which they were taken, with repeats."""
    grid: GridSample
    """Frames are numbered as in the plan."""

    @classmethod
    def of(cls, shape: tuple[int, int], *, neighbours: bool) -> Self:
        """Return samples of images (H, W), without frames; with `neighbours` as in `Sample.at_random`."""
        return cls(Sample.at_random(shape, neighbours=neighbours), TileSample(shape), GridSample(shape))

    def copy(self) -> Self:
        """Return samples of the same frames, which may be divided by themselves."""
        return replace(self, scattered=self.scattered.copy(), tiles=self.tiles.copy(), grid=self.grid.copy())

    @property
    def each(self) -> tuple[Sample, ...]:
        """All samples."""
        return self.scattered, *self.scattered.beside, self.tiles, self.grid

    def add(self, plan: SequencePlan, place: int, grey: Image) -> None:
        """Sample the frame (H, W) at a place in the capture."""
        for sample in self.each:
            if sample.number_of(plan, place) is not None:
                sample.add(plan, place, sample.of(grey))

    @classmethod
    def read(
        cls, plan: SequencePlan, shape: tuple[int, int], read: Callable[[Part], Iterable[Image]], *, neighbours: bool
    ) -> Self:
        """Return samples of images (H, W) of which `read` yields a part of all frames, in order."""
        samples = cls.of(shape, neighbours=neighbours)
        for sample in samples.each:
            for place, levels in enumerate(read((sample.rows, sample.pixels - sample.rows * shape[1]))):
                sample.add(plan, place, levels)
        return samples

    def equalise(self, plan: SequencePlan, frames: Sequence[int], gains: Gains) -> None:
        """Divide some frames by their gains."""
        for sample in (self.scattered, self.tiles, self.grid):
            for frame, gain in zip(frames, gains.at(sample.rows), strict=True):
                number = plan.shown.index(frame) if sample is self.tiles else frame
                if sample.has(number):
                    sample.divide(number, gain)


_QUANTISATION = 1 / 12  # variance of a number that is rounded to integers
_BINS = 10  # of grey levels, for a straight line
# Stray light: largest difference that it may cause, as a share of what the brightest pixels show.
STRAY_PART, _BRIGHTEST = 0.03, 0.995
# Bounds of that difference in grey levels: rounding, and the most that stray light is assumed to cause.
_ROUNDING, _MOST_STRAY = 1.0, 5.0


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a pixel at grey level I: at_black + gain · I."""

    at_black: float
    """Read noise and quantisation."""
    gain: float
    """Shot noise per grey level."""
    stray: float = _MOST_STRAY
    """Smaller differences between frames may be rounding, compression and stray light, whatever the noise."""

    def sigma(self, level: NDArray[np.generic]) -> Floats32:
        """Return the standard deviation in grey levels at each level; any shape."""
        return np.sqrt(self.variance(level))

    def variance(self, level: NDArray[np.generic]) -> Floats32:
        """Return the variance at each level; any shape."""
        variance: Floats32 = level.astype(np.float32)
        variance *= np.float32(self.gain)
        variance += np.float32(self.at_black)
        return variance


def needs_neighbours(plan: SequencePlan) -> bool:
    """Whether a sequence repeats too little light, so that noise must be measured between neighbouring pixels too.

    With a single repeat an exchanged frame would pass for noise.
    """
    return max(0, len(plan.complements) - 1) + max(0, len(plan.fringes) - 1) < MAJORITY


def measure_noise(plan: SequencePlan, sample: Sample, saturation: float) -> NoiseModel:
    """Fit the noise model to a sample of all frames, excluding pixels that reach `saturation` in any of them."""
    levels = sample.levels
    unsaturated = levels.max(axis=0) < saturation
    if not unsaturated.any():
        return NoiseModel(_QUANTISATION, 0.0)
    contrast = float(np.quantile(np.ptp(levels, axis=0), _BRIGHTEST))
    repeats = _repeats(plan, levels)
    curvature = sample.curvature
    if curvature is not None:
        rows = zip(levels, curvature, strict=True)
        repeats += [(level, bend / np.float32(np.sqrt(6))) for level, bend in rows]
    means, differences = (np.stack(parts)[:, unsaturated] for parts in zip(*repeats, strict=True))
    noise = _fit(*_variance_by_level(medians(means, axis=0), differences))
    return replace(noise, stray=min(max(_ROUNDING, STRAY_PART * contrast), _MOST_STRAY))


def _repeats(plan: SequencePlan, levels: Floats32) -> list[tuple[Floats32, Floats32]]:
    """Return, for light that was shown twice, the level (P,) and a difference (P,) with the variance of one pixel."""
    sums = [levels[a] + levels[b] for a, b in plan.complements]
    repeats = [((a + b) / 4, (a - b) / 2) for a, b in pairwise(sums)]
    for first, second in pairwise(plan.fringes):
        weights = [fringe.weights[0].astype(np.float32) for fringe in (first, second)]
        a, b = (weight @ levels[list(f.frames)] for weight, f in zip(weights, (first, second), strict=True))
        gain = np.sqrt(sum(np.sum(weight**2) for weight in weights))
        repeats.append(((a + b) / 2, (a - b) / np.float32(gain)))
    return repeats


def _variance_by_level(level: Floats32, differences: Floats32) -> tuple[list[float], list[float]]:
    """Return mean level and variance in bins of equal width in `level` (P,); `differences` (repeats, P).

    The quieter repeats count: a nonlinear camera adds a difference where stripes are as fine as its pixels.
    """
    # Dither: the median of small integers would jump between multiples of one.
    dithered = differences + np.random.default_rng(SEED).uniform(-0.25, 0.25, len(level)).astype(np.float32)
    bins = np.floor(level / (level.max() + 1e-6) * _BINS).astype(np.int64)
    where, variances = [], []
    for number in range(_BINS):
        chosen = np.flatnonzero(bins == number)
        if len(chosen) >= FEWEST_PIXELS:
            where.append(float(np.mean(level[chosen])))
            variance = robust_sigmas(dithered[:, chosen]) ** 2
            variances.append(float(np.quantile(variance, FEW, method="lower")))
    return where, variances


def _fit(where: list[float], variances: list[float]) -> NoiseModel:
    if not where:
        return NoiseModel(_QUANTISATION, 0.0)
    level, variance = np.array(where), np.maximum(np.array(variances), _QUANTISATION)
    if len(level) == 1:
        return NoiseModel(float(variance[0]), 0.0)
    gain, at_black = np.polyfit(level, variance, 1, w=1 / variance)
    if gain < 0:
        return NoiseModel(float(np.median(variance)), 0.0)
    if at_black < _QUANTISATION:
        lit = level > 0
        at_black, gain = _QUANTISATION, max(0.0, float(np.median((variance - _QUANTISATION)[lit] / level[lit])))
    return NoiseModel(float(at_black), float(gain))
