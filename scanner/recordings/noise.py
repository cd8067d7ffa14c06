"""The noise of averaged pictures, from how frames of one picture differ."""

from collections.abc import Sequence

import numpy as np

from calib.numerics import Floats, Ints
from scanner.recordings.clocks import Clocks
from scanner.recordings.samples import VideoSamples
from scanner.recordings.weights import PictureWeights


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
    return [float(of_frame * np.median(each.noise)) for of_frame, each in zip(of_frames, weights, strict=True)]


def _of_a_frame(samples: VideoSamples, clocks: Clocks, numbers: Ints, weights: Floats) -> float:
    """NaN if no row has two frames."""
    seen = samples.light(clocks.tone, numbers)
    used = weights > 0.5 * weights.max(axis=0, keepdims=True)
    count = used.sum(axis=0)
    mean = np.einsum("nr,nrc->rc", used, seen) / np.maximum(count, 1)[:, None]
    squares = np.einsum("nr,nrc->r", used, (seen - mean) ** 2) / max(seen.shape[2], 1)
    of_rows = squares[count > 1] / (count[count > 1] - 1)
    return float(np.sqrt(of_rows.mean())) if of_rows.size else float("nan")
