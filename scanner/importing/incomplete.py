"""Folders that hold no capture in a known order: white or black are missing, or there are frames too many.

A camera that triggers once too often takes the same picture again, sequences with inverses may omit white and black,
and some programs take ambient light first, or a texture last.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product

import numpy as np

from scanner.importing.frame_files import FrameFiles
from scanner.importing.samples import LevelSamples
from scanner.patterns import Black, Pattern, White

# Largest difference of two frames of one picture, in swings of the lit pixels, at nearly all of them.
_SAME, _NEARLY_ALL = 0.1, 0.98
# Least distance of a frame from half-way between dark and bright, in swings, at half of the pixels.
_RESOLVED = 0.3
_MOST_SURPLUS = 2  # frames at either end
# Shares of the swing that are dark or bright; of the lit pixels, the least of either in a bit, and the least of both.
_DARK, _BRIGHT, _LEAST_OF_EITHER, _LEAST_OF_BOTH = 0.25, 0.75, 0.1, 0.8

MISSING_ENDS: tuple[tuple[Pattern, ...], ...] = ((Black(),), (White(),), (White(), Black()))


def without_duplicates(files: FrameFiles, samples: LevelSamples) -> Iterator[tuple[FrameFiles, LevelSamples]]:
    """The frames without duplicates of the previous frame: without all of these, or without one.

    If nothing is lit, all frames look alike, and none counts as a duplicate; nor does a frame whose stripes the camera
    does not resolve. `samples`: of the numbered frames, then of white and black.
    """
    if not np.any(samples.lit):
        return
    levels = samples.levels[:, samples.lit]
    frames = (levels[: len(files.numbered)] - levels.min(axis=0)) / samples.swing[samples.lit]
    doubles = [
        number
        for number, (before, frame) in enumerate(pairwise(frames), 1)
        if np.quantile(np.abs(frame - before), _NEARLY_ALL) < _SAME and np.median(np.abs(frame - 0.5)) > _RESOLVED
    ]
    for numbers in [doubles, *([[double] for double in doubles] if len(doubles) > 1 else [])]:
        if numbers:
            yield _without(files, samples, numbers)


def without_ends(files: FrameFiles, samples: LevelSamples) -> Iterator[tuple[FrameFiles, LevelSamples]]:
    """The frames without some of the first or the last, which show no pattern: ambient light, or a texture; fewest
    first.
    """
    if not np.any(samples.lit):
        return
    count = len(files.numbered)
    ways = product(range(_MOST_SURPLUS + 1), repeat=2)
    for first, last in sorted(ways, key=lambda way: (sum(way), max(way))):
        surplus = [*range(first), *range(count - last, count)]
        if 0 < len(surplus) < count and not any(_is_striped(samples, number) for number in surplus):
            yield _without(files, samples, surplus)


def _is_striped(samples: LevelSamples, number: int) -> bool:
    """Whether a frame is a bit of a code: some pixels are dark, others bright, and hardly any between."""
    levels = samples.levels[:, samples.lit]
    shares = (levels[number] - levels.min(axis=0)) / samples.swing[samples.lit]
    dark, bright = float(np.mean(shares < _DARK)), float(np.mean(shares > _BRIGHT))
    return min(dark, bright) > _LEAST_OF_EITHER and dark + bright > _LEAST_OF_BOTH


def _without(files: FrameFiles, samples: LevelSamples, numbers: list[int]) -> tuple[FrameFiles, LevelSamples]:
    levels = np.delete(samples.levels, numbers, axis=0)
    return files.without([files.numbered[number] for number in numbers]), replace(samples, levels=levels)
