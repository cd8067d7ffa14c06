"""Compute the pictures of a capture as weighted sums of the frames of a recording, which is read once more.

Noise follows from how frames of one picture differ. The smooth fringe shift due to video compression follows from the
difference of the forward and the backward pass: errors of an encoder are independent each time a picture is shown, and
ghosting has the opposite sign in reverse order. So half the difference is as large as the error of the mean.
"""

import math
import tempfile
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import CUBIC, Floats, Image, Ints, orthonormal_polynomials
from scanner.patterns import Axis, Phase
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import Light, VideoSamples
from scanner.recordings.video_file import ToneCurve, VideoFile
from scanner.recordings.weights import PictureWeights
from scanner.ui import Progress

_MOST_BYTES_IN_MEMORY = 1_000_000_000
_PIXELS_OF_A_PASS = 100_000
_HIGHEST = 65_535
# Errors common to both passes are not seen: true errors were 1 to 1.5 times the measured ones, and more on dark faces.
_UNSEEN = 2.0
_LEAST_SHARE = 0.25  # least share of a picture's weight, in either pass
_LEAST_AMPLITUDE = 0.1  # least amplitude relative to the best lit pixels
_PARTS = 2  # parts of the height and of the width, each about as large as a face
_FEWEST = 30 * CUBIC
_OUTLIER = 5.0  # times the median is an outlier
_WELL_LIT = 98.0


@dataclass(frozen=True)
class Averaged:
    """Averaged pictures, upright or not."""

    pictures: Light
    """Light from 0 to 1, (pictures, H, W)."""
    kept: Mapping[int, Image]
    """Luma (H, W) of the frames that were to be kept."""
    passes: Light
    """The parts from the forward and the backward pass, at every `step`-th pixel, (2, pictures, H / step, W / step)."""
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
    for picture, frame_weights in enumerate(weights):
        for place, number in enumerate(frame_weights.numbers):
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


def noise_of(samples: VideoSamples, weights: Sequence[PictureWeights], clocks: Clocks) -> list[float]:
    """Estimate the noise of each picture: the standard deviation of its light, relative to the range 0 to 1, as median
    over rows.

    The noise of a frame is estimated from frames of equal weight in the sampled rows; for a picture that has only one
    frame, from the other pictures.
    """
    rows = samples.rows.astype(np.intp)
    of_frames = np.array([_of_a_frame(samples, clocks, weight.numbers, weight.weights[:, rows]) for weight in weights])
    known = of_frames[np.isfinite(of_frames)]
    usual = float(np.median(known)) if known.size else 0.0
    of_frames = np.where(np.isfinite(of_frames), of_frames, usual)
    return [
        float(of_frame * np.median(frame_weights.noise))
        for of_frame, frame_weights in zip(of_frames, weights, strict=True)
    ]


def _of_a_frame(samples: VideoSamples, clocks: Clocks, numbers: Ints, weights: Floats) -> float:
    """NaN if no row has two frames."""
    light = samples.light(clocks.tone, numbers)
    used = weights > 0.5 * weights.max(axis=0, keepdims=True)
    count = used.sum(axis=0)
    mean = np.einsum("nr,nrc->rc", used, light) / np.maximum(count, 1)[:, None]
    squares = np.einsum("nr,nrc->r", used, (light - mean) ** 2) / max(light.shape[2], 1)
    of_rows = squares[count > 1] / (count[count > 1] - 1)
    return float(np.sqrt(of_rows.mean())) if of_rows.size else float("nan")


def smooth_px(programme: Programme, weights: Sequence[PictureWeights], averaged: Averaged) -> float | None:
    """Return the `smooth_px` of `calib.refinement.Shifts`, in projector pixels, for the shortest fringes; None without
    fringes.
    """
    fringes = defaultdict[tuple[Axis, float], list[tuple[int, Phase]]](list)
    for number, pattern in enumerate(programme.patterns):
        if isinstance(pattern, Phase):
            fringes[pattern.axis, pattern.period].append((number, pattern))
    shortest = {axis: min(period for along, period in fringes if along == axis) for axis, _ in fringes}
    squares = list[float]()
    for axis, period in shortest.items():
        phasors = _of_passes(fringes[axis, period], weights, averaged)
        px_per_radian = period / (2 * math.pi)
        squares += [px_per_radian**2 * square for square in _squares_of_modes(phasors)]
    return _UNSEEN * math.sqrt(max(float(np.mean(squares)), 0.0)) if squares else None


def _of_passes(
    fringe: Sequence[tuple[int, Phase]], weights: Sequence[PictureWeights], averaged: Averaged
) -> NDArray[np.complex64]:
    """(2, h, w): amplitude and phase of a fringe there and back; 0 where a pass lacks one of its pictures."""
    total = np.zeros((2, *averaged.passes.shape[2:]), np.complex64)
    complete = np.ones(total.shape[1], np.bool_)
    for number, pattern in fringe:
        frame_weights, rows = weights[number], weights[number].weights[:, :: averaged.step]
        of_pass = np.stack([rows[~frame_weights.back].sum(axis=0), rows[frame_weights.back].sum(axis=0)])
        # Unmixed frames form a picture only together; some of their weights are negative.
        complete &= (rows >= 0).all(axis=0) & (of_pass > _LEAST_SHARE * of_pass.sum(axis=0)).all(axis=0)
        scale = (np.exp(-2j * np.pi * pattern.shift) / np.maximum(of_pass, 1e-6)).astype(np.complex64)
        total += averaged.passes[:, number] * scale[..., None]
    return total * complete[:, None]


def _squares_of_modes(phasors: NDArray[np.complex64]) -> list[float]:
    """For each part of the image that the fringe lights: the mean square of the amplitudes of smooth modes, without
    that of pixels that err independently; of half the phase in radians that separates both passes.
    """
    amplitude = np.abs(phasors).min(axis=0)
    lit = amplitude > _LEAST_AMPLITUDE * np.percentile(amplitude, _WELL_LIT)
    pixels = np.argwhere(lit)
    if len(pixels) < _FEWEST:
        return []
    half = np.angle(phasors[1] * np.conj(phasors[0]))[lit] / 2
    low, high = np.percentile(pixels, (2, 98), axis=0)
    part = np.clip((pixels - low) / (high - low + 1) * _PARTS, 0, _PARTS - 1).astype(np.intp) @ (_PARTS, 1)
    squares = []
    for number in range(_PARTS**2):
        of_part, at = half[part == number], pixels[part == number].astype(np.float64)
        if len(of_part) < _FEWEST:
            continue
        off = np.abs(of_part - np.median(of_part))
        kept = off <= _OUTLIER * np.median(off)
        modes = orthonormal_polynomials(at[kept])
        amplitudes = modes.T @ of_part[kept]
        rest = of_part[kept] - modes @ amplitudes
        squares.append(float(np.mean(amplitudes**2) - np.mean(rest**2)) / len(rest))
    return squares
