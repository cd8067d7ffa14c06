"""Compute the pictures of a capture as weighted sums of the frames of a recording, which is read once more."""

import math
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image
from scanner.recordings.samples import Light
from scanner.recordings.tone_curve import ToneCurve
from scanner.recordings.video_file import VideoFile
from scanner.recordings.weights import PictureWeights
from scanner.ui import Progress

_MOST_BYTES_IN_MEMORY = 1_000_000_000
_PIXELS_OF_A_PASS = 100_000
_HIGHEST = 65_535


@dataclass(frozen=True)
class Averaged:
    """Light from 0 to 1, (pictures, H, W), upright or not; luma (H, W) of the `kept` frames.

    `passes` (2, pictures, H / step, W / step): the parts from the forward and the backward pass, at every `step`-th
    pixel.
    """

    pictures: Light
    kept: Mapping[int, Image]
    passes: Light
    step: int


def average(
    video: VideoFile,
    weights: Sequence[PictureWeights],
    tone: ToneCurve,
    frames: int,
    keep: Collection[int],
    progress: Progress,
) -> Averaged:
    """Read a recording again and average its frames. Raises InputError."""
    lights = video.codes.light(tone)
    height, width = video.size.height, video.size.width
    sums = _zeros(len(weights), height, width)
    step = max(1, round(math.sqrt(height * width / _PIXELS_OF_A_PASS)))
    passes = np.zeros((2, len(weights), -(-height // step), -(-width // step)), np.float32)
    uses: list[list[tuple[int, int]]] = [[] for _ in range(frames)]
    for picture, each in enumerate(weights):
        for place, number in enumerate(each.numbers):
            uses[int(number)].append((picture, place))
    kept, wanted = dict[int, Image](), set(keep)
    read = progress.track(video.frames(), frames, "Averaging the frames")
    for number, (used, (_, luma)) in enumerate(zip(uses, read, strict=True)):
        if number in wanted:
            kept[number] = luma.copy()
        if not used:
            continue
        light = lights[luma]
        for picture, place in used:
            of_rows = weights[picture].weights[place].astype(np.float32)
            rows = np.flatnonzero(of_rows)
            span = slice(int(rows[0]), int(rows[-1]) + 1)
            sums[picture, span] += light[span] * of_rows[span, None]
            passes[int(weights[picture].back[place]), picture] += light[::step, ::step] * of_rows[::step, None]
    return Averaged(sums, kept, passes, step)


def _zeros(*shape: int) -> Light:
    """Allocate in memory, or in an unlinked temporary file if large."""
    if 4 * math.prod(shape) <= _MOST_BYTES_IN_MEMORY:
        return np.zeros(shape, np.float32)
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, np.float32, "w+", shape=shape)


def image_of(light: Light, quarter_turns: int) -> NDArray[np.uint16]:
    """A 16-bit image in proportion to light, upright."""
    image = np.rint(np.clip(light, 0, 1) * _HIGHEST).astype(np.uint16)
    return np.ascontiguousarray(np.rot90(image, quarter_turns))
