"""Folders that hold no capture in a known order: white or black are missing, or a frame occurs twice.

A camera that triggers once too often takes the same picture again, and sequences with inverses may omit white and
black.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from scanner.importing.frame_files import FrameFiles
from scanner.importing.samples import LevelSamples
from scanner.patterns import Black, Pattern, White

# Largest difference of two frames of one picture, in swings of the lit pixels, at nearly all of them.
_SAME, _NEARLY_ALL = 0.1, 0.98

MISSING_ENDS: tuple[tuple[Pattern, ...], ...] = ((Black(),), (White(),), (White(), Black()))


def without_duplicates(files: FrameFiles, samples: LevelSamples) -> Iterator[tuple[FrameFiles, LevelSamples]]:
    """The frames without duplicates of the previous frame: without all of these, or without one.

    If nothing is lit, all frames look alike, and none counts as a duplicate. `samples`: of the numbered frames, then of
    white and black.
    """
    if not np.any(samples.lit):
        return
    frames = samples.levels[: len(files.numbered), samples.lit] / samples.swing[samples.lit]
    doubles = [
        number
        for number, (before, frame) in enumerate(pairwise(frames), 1)
        if np.quantile(np.abs(frame - before), _NEARLY_ALL) < _SAME
    ]
    for left_out in [doubles, *([[double] for double in doubles] if len(doubles) > 1 else [])]:
        if left_out:
            levels = np.delete(samples.levels, left_out, axis=0)
            yield files.without([files.numbered[number] for number in left_out]), replace(samples, levels=levels)
