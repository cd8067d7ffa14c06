"""Samples of the frames, from which everything but the coordinates is measured: pixels at random, tiles, and a grid."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Floats32, Image, Ints, Part, at_random
from scanner.decoding.light.brightness import Gains
from scanner.decoding.light.exposures import BAYER_PX
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import MAJORITY

_MOST_PIXELS = 16384  # at random, so that a hundred are left in 1 % of the picture
TILE_PX, MOST_ALONG = 10, 24  # size of a tile; largest number of tiles along each side of the image
_MOST_OF_GRID = 224  # pixels along the longer side: smaller objects affect few matches


@dataclass(frozen=True)
class PartOfFrames:
    """The same pixels of all frames of a capture."""

    plan: SequencePlan
    """Of the capture."""
    rows: Ints
    """(...): the image rows of the pixels, in a shape that fits theirs."""
    read: Callable[[Sequence[int]], Iterator[Image]]
    """Yields the pixels (...) in the frames at some places, in ascending order."""


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

    def divided(self, by: Mapping[int, Floats]) -> Self:
        """Return the sample with some frames divided by a factor of each pixel (...), or of all; by number."""
        if not by:
            return self
        divided = copy(self)
        quotients = {frame: (self._frames[frame] / factor).astype(np.float32) for frame, factor in by.items()}
        divided._frames, divided.is_divided = self._frames | quotients, True
        divided.beside = tuple(sample.divided(by) for sample in self.beside)
        return divided

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

    def leaving_out(self, moved: Bools) -> "TileSample":
        """Return the sample without the pixels of the image (H, W) where objects moved among the `static` ones (P,)."""
        rest = copy(self)
        rest.static = ~cast(Bools, self.of(moved))
        return rest

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
    def of(cls, plan: SequencePlan, shape: tuple[int, ...]) -> Self:
        """Return samples of the images (H, W) of a sequence, without frames.

        If the sequence repeats too little light, noise must be measured between neighbouring pixels too: with a single
        repeat an exchanged frame would pass for noise.
        """
        height, width = shape
        repeats = sum(max(0, len(groups) - 1) for groups in (plan.complements, plan.fringes))
        scattered = Sample.at_random((height, width), neighbours=repeats < MAJORITY)
        return cls(scattered, TileSample(scattered.shape), GridSample(scattered.shape))

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
    def read(cls, plan: SequencePlan, shape: tuple[int, ...], read: Callable[[Part], Iterable[Image]]) -> Self:
        """Return samples of images (H, W) of which `read` yields a part of all frames, in order."""
        samples = cls.of(plan, shape)
        for sample in samples.each:
            for place, levels in enumerate(read((sample.rows, sample.pixels - sample.rows * shape[1]))):
                sample.add(plan, place, levels)
        return samples

    def divided(self, plan: SequencePlan, groups: Mapping[tuple[int, ...], Gains]) -> "Samples":
        """Return samples with groups of frames divided by their gains."""
        scattered, tiles, grid = (
            sample.divided(
                {
                    number: gain
                    for frames, gains in groups.items()
                    for frame, gain in zip(frames, gains.at(sample.rows), strict=True)
                    if sample.has(number := plan.shown.index(frame) if sample is self.tiles else frame)
                }
            )
            for sample in (self.scattered, self.tiles, self.grid)
        )
        return Samples(scattered, cast(TileSample, tiles), cast(GridSample, grid))
