"""Sample some pixels of every frame of a recording: enough for both clocks, the tone curve and changes by the
camera.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Ints
from scanner.errors import InputError
from scanner.recordings.video_file import ToneCurve, VideoFile
from scanner.ui import Progress

Light = NDArray[np.float32]

_ROWS, _COLUMNS = 40, 64
_EDGE = 0.02  # share of the height, above and below, that is hardly lit
_SEED = 1
_UNEVEN_S, _MOST_UNEVEN = 2e-4, 0.45  # deviations of stamps: mean of even ones, and the largest in frame intervals
_FIRST_FRAMES = 16
_LIT = 0.25  # share of the range of the best lit samples
_WELL_LIT = 98.0
_LEAST_RANGE = 0.04  # share of the luma range; less is noise


@dataclass(frozen=True)
class VideoSamples:
    """`codes` (N, R, C) of luma at `rows` (R,), at the same C columns in all of them; `times_s` (N,) of the frames."""

    codes: NDArray[np.unsignedinteger[Any]]
    times_s: Floats
    rows: Floats
    video: VideoFile

    def light(self, tone: ToneCurve, numbers: Ints) -> Light:
        """(n, R, C): 0 to 1, of frames (n,)."""
        light: Light = self.video.codes.light(tone)[self.codes[numbers]]
        return light

    @property
    def middle_row(self) -> float:
        """The row whose exposure's middle a frame's time is taken to be."""
        return (self.video.size.height - 1) / 2

    @cached_property
    def frame_interval_s(self) -> float:
        """The usual one."""
        return float(np.median(np.diff(self.times_s)))

    def with_even_times(self) -> "VideoSamples | None":
        """With times of frames that came evenly, but for lost ones; None if they are even, or could not have been."""
        first, times = 0.0, self.times_s
        interval, known = self.frame_interval_s, _FIRST_FRAMES
        while True:
            numbers = np.rint((times[:known] - times[0] - first) / interval)
            interval, first = np.polyfit(numbers, times[:known] - times[0], 1).tolist()
            if known >= len(times):
                break
            known *= 2
        even = times[0] + first + interval * numbers
        off = np.abs(times - even)
        if off.max() > _MOST_UNEVEN * interval or np.any(np.diff(numbers) < 1) or np.mean(off) < _UNEVEN_S:
            return None
        return replace(self, times_s=even)

    @cached_property
    def range(self) -> Floats:
        """The range (R, C) from the darkest to the brightest frame, without outliers, relative to the range of luma."""
        # Of a row at a time, because this copies.
        of_rows = [np.percentile(self.codes[:, row], (2, 98), axis=0) for row in range(len(self.rows))]
        low, high = np.stack(of_rows, axis=1)
        spread: Floats = (high - low) / (self.video.codes.white - self.video.codes.black)
        return spread

    @cached_property
    def lit(self) -> Bools:
        """(R, C): samples that the projector lights. Raises InputError if nothing changes."""
        most = float(np.percentile(self.range, _WELL_LIT))
        if most < _LEAST_RANGE:
            raise InputError(f"{self.video.path}: nothing in it changes its brightness: no start mark was filmed")
        return self.range > _LIT * most


def take_samples(video: VideoFile, progress: Progress) -> VideoSamples:
    """Read all of a recording once. Raises InputError."""
    width, height = video.size
    rng = np.random.default_rng(_SEED)  # random, because a grid would beat with the stripes
    rows = np.unique(np.linspace(_EDGE * height, (1 - _EDGE) * (height - 1), _ROWS).astype(np.intp))
    columns = np.sort(rng.choice(width, min(_COLUMNS, width), replace=False))
    times, codes = list[float](), bytearray()
    kind: np.dtype[np.unsignedinteger[Any]] = np.dtype(np.uint8)
    for time_s, luma in progress.track(video.frames(), video.expected_frames, "Looking at the frames"):
        times.append(time_s)
        codes += luma[np.ix_(rows, columns)].tobytes()
        kind = luma.dtype
    samples = np.frombuffer(codes, kind).reshape(-1, len(rows), len(columns))
    return VideoSamples(samples, np.array(times), rows.astype(np.float64), video)
