"""Films of a simulated room by an unsynchronised camera: player, projector, phone, encoder."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from pathlib import Path

import av
import cv2
import numpy as np

from calib.numerics import Floats, Image
from hw.simulated import Light

_SAME = 1.0  # mean difference of grey levels below which a frame repeats the previous picture
_STEPS = 60_000  # codes of light in stored pictures
_TICKS = 90_000
_CODES = 65_535  # codes of light in the table of a tone curve
# Light 0 … 1 → level 0 … 1.
_TONES: dict[str, Callable[[Floats], Floats]] = {
    "linear": lambda light: light,
    "srgb": lambda light: np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
    ),
    "bt709": lambda light: np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 1e-9) ** 0.45 - 0.099),
    # Filmic: a toe, a shoulder, and more contrast between them (Hable's curve, normalised).
    "filmic": lambda light: (_hable(2.2 * light) / _hable(np.array(2.2))) ** (1 / 2.2),
}


@dataclass(frozen=True)
class Played:
    """`pictures`: 8-bit images as sent to the projector; `shown`: their indices and start times, in order."""

    pictures: list[Image]
    shown: list[tuple[float, int]]
    length_s: float


def play(video: Path) -> Played:
    """Decode a whole video; repeated pictures are kept once."""
    pictures: list[Image] = []
    shown: list[tuple[float, int]] = []
    rate = 30.0
    with av.open(str(video)) as container:
        stream = container.streams.video[0]
        rate = float(stream.average_rate or rate)
        number = 0
        for number, frame in enumerate(container.decode(stream)):
            grey = cv2.cvtColor(frame.to_ndarray(format="rgb24"), cv2.COLOR_RGB2GRAY)
            if shown and _alike(grey, pictures[shown[-1][1]]):
                continue
            known = next((index for index, picture in enumerate(pictures) if _alike(grey, picture)), len(pictures))
            pictures[known:] = pictures[known:] or [grey]
            shown.append((number / rate, known))
    return Played(pictures, shown, (number + 1) / rate)


def _alike(one: Image, other: Image) -> bool:
    return float(np.mean(cv2.absdiff(one, other))) < _SAME


def _hable(x: Floats) -> Floats:
    a, b, c, d, e, f = 0.15, 0.50, 0.10, 0.20, 0.02, 0.30
    curve: Floats = (x * (a * x + c * b) + d * e) / (x * (a * x + b) + d * f) - e / f
    return curve


@cache
def _curve(tone: str) -> Light:
    """Level 0 … 1 for each code of light, (codes,)."""
    return np.asarray(_TONES[tone]((np.arange(_CODES + 1) + 0.5) / (_CODES + 1)), np.float32)


@dataclass(frozen=True)
class Camera:
    """A camera and its conditions. Times in seconds; `fast`: relative speed of its clock over the player's.

    `repeated` and `dropped`: numbers of frames. `gain`: brightness over the film's time; `motion`: of the picture, in
    px along x and y and degrees about its centre.
    """

    rate: float = 30.0
    exposure_s: float = 1 / 60
    readout_s: float = 0.02
    tone: str = "srgb"
    sharpening: float = 0.3
    codec: str = "libx264"
    bit_rate: float = 25e6
    ten_bit: bool = False
    fast: float = 0.001
    full_well: float = 8000.0
    read_noise: float = 4.0
    refresh_hz: float = 60.0
    response_s: float = 0.002
    scan_out_s: float = 0.008
    jitter_s: float = 0.0
    repeated: tuple[int, ...] = ()
    dropped: tuple[int, ...] = ()
    gain: Callable[[float], float] | None = None
    motion: Callable[[float], tuple[float, float, float]] | None = None
    pause: tuple[float, float] | None = None  # pause of the player: start in the video, and duration
    seed: int = 0


@dataclass(frozen=True)
class Clip:
    """Start in the video and duration of a film."""

    start_s: float
    length_s: float


def film(path: Path, played: Played, light_of: Callable[[Image], Light], camera: Camera, clip: Clip) -> None:
    """Write a recording. `light_of`: what the camera sees of a picture, (H, W); 1 is full scale."""
    lights = _Lights(played, light_of)
    height, width = lights.of(0).shape
    changes, which = _timetable(played, camera)
    rng = np.random.default_rng([camera.seed, 7])
    with av.open(str(path), "w") as container:
        stream = container.add_stream(camera.codec, rate=Fraction(camera.rate).limit_denominator(1001))
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p10le" if camera.ten_bit else "yuv420p"
        stream.bit_rate = int(camera.bit_rate)
        stream.time_base = stream.codec_context.time_base = Fraction(1, _TICKS)
        stream.options = {"preset": "veryfast"} | ({"x265-params": "log-level=none"} if "265" in camera.codec else {})
        last: Light | None = None
        for number in range(int(clip.length_s * camera.rate)):
            if number in camera.dropped:
                continue
            if number not in camera.repeated or last is None:
                begins = clip.start_s + number / camera.rate * (1 + camera.fast)
                last = _levels(_integrated(lights, changes, which, begins, camera), begins, camera, rng)
            pts = round((number / camera.rate + camera.jitter_s * rng.uniform(-1, 1)) * _TICKS)
            for packet in stream.encode(_frame(last, camera, pts)):
                container.mux(packet)
        for packet in stream.encode(None):
            container.mux(packet)


class _Lights:
    """The view of each picture, computed once and stored compactly."""

    def __init__(self, played: Played, light_of: Callable[[Image], Light]) -> None:
        self._of = partial(self._seen, played, light_of)
        self._kept: dict[int, Image] = {}

    def of(self, number: int) -> Light:
        if number not in self._kept:
            self._kept[number] = self._of(number)
        return self._kept[number] * np.float32(1 / _STEPS)

    @staticmethod
    def _seen(played: Played, light_of: Callable[[Image], Light], number: int) -> Image:
        return np.rint(np.clip(light_of(played.pictures[number]), 0, 65_535 / _STEPS) * _STEPS).astype(np.uint16)


def _timetable(played: Played, camera: Camera) -> tuple[Floats, list[int]]:
    """Start times of pictures by the player's clock, at the projector's refreshes; the first was shown before."""
    times = np.array([time for time, _ in played.shown])
    if camera.pause:
        times = times + np.where(times > camera.pause[0], camera.pause[1], 0.0)
    times = np.ceil(times * camera.refresh_hz - 1e-6) / camera.refresh_hz
    times[0] = -np.inf
    return times, [number for _, number in played.shown]


def _integrated(lights: _Lights, changes: Floats, which: list[int], begins: float, camera: Camera) -> Light:
    """Mean light (H, W) over each row's exposure; the time of a frame is the start of its first row."""
    height = lights.of(which[0]).shape[0]
    down = np.arange(height) / height
    since = begins + down * (camera.readout_s - camera.scan_out_s)
    ends = float(since.max() + camera.exposure_s)
    first = max(0, int(np.searchsorted(changes, since.min() - 20 * camera.response_s)) - 1)
    last = int(np.searchsorted(changes, ends))
    total = np.zeros_like(lights.of(which[first]))
    for number in range(first, last):
        share = _lit(since, changes[number], camera) if number > first else np.ones(height)
        if number + 1 < len(changes):
            share = share - _lit(since, changes[number + 1], camera)
        if np.any(share > 1e-6):
            total += share.astype(np.float32)[:, None] * lights.of(which[number])
    return total


def _lit(since: Floats, change: float, camera: Camera) -> Floats:
    """Share of an exposure (H,) lit by a picture that comes at `change`, with an exponential response."""

    def light_until(time: Floats) -> Floats:
        after = np.maximum(time - change, 0)
        lag = camera.response_s
        return after - lag * (1 - np.exp(-after / lag)) if lag else after

    share: Floats = (light_until(since + camera.exposure_s) - light_until(since)) / camera.exposure_s
    return share


def _levels(light: Light, time_s: float, camera: Camera, rng: np.random.Generator) -> Light:
    """Levels 0 … 1 (H, W) of a frame: gain, motion, noise, tone curve, sharpening."""
    if camera.motion is not None:
        x, y, turn_deg = camera.motion(time_s)
        by = cv2.getRotationMatrix2D((light.shape[1] / 2, light.shape[0] / 2), turn_deg, 1.0)
        by[:, 2] += np.array((x, y))
        light = np.asarray(cv2.warpAffine(light, by, light.shape[::-1], borderMode=cv2.BORDER_REPLICATE), np.float32)
    electrons = light * camera.full_well
    noise = rng.standard_normal(light.shape, dtype=np.float32)
    electrons = electrons + noise * np.sqrt(np.maximum(electrons, 0) + np.float32(camera.read_noise**2))
    gain = 1.0 if camera.gain is None else camera.gain(time_s)
    scaled = np.clip(electrons * np.float32(gain * _CODES / camera.full_well), 0, _CODES)
    level = _curve(camera.tone)[scaled.astype(np.uint16)]
    if camera.sharpening:
        soft = cv2.GaussianBlur(level, (0, 0), 1.0)
        level = np.asarray(level + np.float32(camera.sharpening) * (level - soft), np.float32)
    return np.asarray(np.clip(level, 0, 1), np.float32)


def _frame(level: Light, camera: Camera, pts: int) -> av.VideoFrame:
    """Luma in the limited range, without colour."""
    scale = 4 if camera.ten_bit else 1
    kind = np.uint16 if camera.ten_bit else np.uint8
    height, width = level.shape
    frame = av.VideoFrame(width, height, "yuv420p10le" if camera.ten_bit else "yuv420p")
    luma = np.rint(scale * (16 + 219 * level)).astype(kind)
    for plane, values in zip(
        frame.planes, (luma, *2 * [np.full((height // 2, width // 2), 128 * scale, kind)]), strict=True
    ):
        rows = np.zeros((plane.height, plane.line_size // kind().itemsize), kind)
        rows[:, : values.shape[1]] = values
        plane.update(rows.tobytes())
    frame.pts, frame.time_base = pts, Fraction(1, _TICKS)
    return frame
