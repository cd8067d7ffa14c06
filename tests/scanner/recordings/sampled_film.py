"""Samples of a film by formula: the light of each sampled pixel, row by row, without optics or an encoder."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.geometry import Size
from calib.numerics import Floats
from scanner.patterns import PRESETS, draw
from scanner.recordings import Programme, programme_of
from scanner.recordings.programme import BLACK, LEAD_IN_S, WHITE
from scanner.recordings.samples import VideoSamples
from scanner.recordings.video_file import LumaCodes, ToneCurve, VideoFile

SIZE, PROJECTOR = Size(480, 270), Size(128, 72)
_ROWS, _COLUMNS = 24, 32
_REFRESH_HZ = 60
_REACH_S = 0.1
_SHOT_NOISE, _DARK = 0.02, 0.02  # of white, and the light of black


@dataclass(frozen=True)
class FilmClocks:
    """Clocks of a camera and of the player that it films."""

    rate: float
    exposure_s: float
    readout_s: float  # of all rows
    hold_s: float = 0.2
    fast: float = 0.0  # relative speed of the camera's clock over the player's
    start_s: float = 0.7  # of the film, in the video
    late: Sequence[int] = ()  # changes of the picture that came a refresh late
    dropped: Sequence[int] = ()  # frames
    loops: int = 1
    uneven_stamps_s: float = 0.0  # most by which a frame's stamp is off
    uneven_frames_s: float = 0.0  # most by which its exposure is


def sample_film(clocks: FilmClocks, seed: int = 0) -> tuple[Programme, VideoSamples]:
    """The video of the preset 'quick' and the samples of its film by a camera with an sRGB tone curve."""
    rng = np.random.default_rng(seed)
    programme = programme_of(PRESETS["quick"].patterns(PROJECTOR), PROJECTOR, clocks.hold_s, clocks.loops)
    rows = np.linspace(0.02 * SIZE.height, 0.98 * SIZE.height, _ROWS).round()
    x = rng.integers(0, PROJECTOR.width, (_ROWS, _COLUMNS))
    y = rng.integers(0, PROJECTOR.height, (_ROWS, _COLUMNS))
    albedo = rng.uniform(0.3, 0.9, (_ROWS, _COLUMNS))
    fields = {WHITE: np.ones_like(albedo), BLACK: np.zeros_like(albedo)}
    lights = [
        _DARK + albedo * (fields[k] if k in fields else draw(programme.patterns[k], PROJECTOR)[y, x] / 255)
        for k in (BLACK, *programme.slots, BLACK)
    ]
    changes = LEAD_IN_S + np.arange(len(lights) - 1) * programme.hold_s - clocks.start_s
    changes[list(clocks.late)] += 1 / _REFRESH_HZ
    numbers = np.setdiff1d(np.arange(int((programme.length_s - clocks.start_s) * clocks.rate)), clocks.dropped)
    off = np.random.default_rng(seed + 1).uniform(-1, 1, len(numbers))
    exposed = numbers / clocks.rate * (1 + clocks.fast) + clocks.uneven_frames_s * off
    begins = exposed[:, None] + rows / SIZE.height * clocks.readout_s
    codes = np.empty((len(numbers), _ROWS, _COLUMNS), np.uint8)
    for frame, since in enumerate(begins):
        first, last = np.searchsorted(changes, (since.min() - _REACH_S, since.max() + _REACH_S))
        # The share of what comes after each change, in every row.
        after = np.clip((since + clocks.exposure_s - changes[first:last, None]) / clocks.exposure_s, 0, 1)
        light = np.array(lights[first])
        for change, share in zip(range(first, last), after, strict=True):
            light += share[:, None] * (lights[change + 1] - lights[change])
        light += _SHOT_NOISE * np.sqrt(light) * rng.standard_normal(light.shape)
        codes[frame] = np.rint(16 + 219 * _srgb(np.clip(light, 0, 1)))
    video = VideoFile(Path("film.mp4"), SIZE, 0, LumaCodes(16, 235), len(numbers), programme.length_s)
    return programme, VideoSamples(codes, numbers / clocks.rate + clocks.uneven_stamps_s * off, rows, video)


def _srgb(light: Floats) -> Floats:
    levels = np.linspace(0, 1, 2048)
    return np.interp(light, ToneCurve().light(levels), levels)
