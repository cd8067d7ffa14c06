"""Scans from unsynchronised films of simulated rooms, compared with the truth.

    python benchmarks/bench_recordings.py [--rooms 0] [--films phone sharpened …] [--width 640]
    python benchmarks/bench_recordings.py --drawn 200 --width 480

Every film shows the video of `scan patterns --video`, by a camera of `filming/`, which shares no code with
the reader: clocks 0.1 % off, any start. The bit rate is that of 1080p in proportion to the pixels; --width 1920
films 1920 × 1080 with a projector of 854 × 480. --drawn draws cameras, videos and disturbances at random, ten to a
room. 'error' is the mean absolute error of (f_c, f_p, x_p, y_p), 'sigmas' the largest of the four in sigmas of its own;
'of sigma' is the root mean square of matches' errors over their sigmas; a refused film gives the reason. The last line
sums up: 'confident and wrong' is off by more than 4 sigma.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from filming import Camera, Clip, Played, film, play
from rich.console import Console
from rich.table import Table

from calib.geometry import Calibration, Matches, Size
from calib.numerics import Floats, Image
from calib.refusal import RefusalError
from hw.settings import SimulatedRigSettings
from hw.simulated import Light, SimulatedRoom
from scanner import load_config, replay
from scanner.errors import InputError
from scanner.patterns import PRESETS, PresetName
from scanner.quantities import intrinsic_errors_percent
from scanner.recordings import Programme, exposure_text, import_recording, programme_of, write_player_video
from scanner.ui import Terminal

FULL_PIXELS = 1920 * 1080
MOST_SIGMAS = 4.0
WRONG_SIGMAS = 10.0  # of a match
PER_ROOM = 10  # random films per room


@dataclass(frozen=True)
class Filmed:
    """A camera and a video whose pictures last `hold_s`."""

    camera: Camera
    hold_s: float = 0.2
    loops: int = 1


def films() -> dict[str, Filmed]:
    phone = Camera()

    def of(**changes: object) -> Filmed:
        return Filmed(replace(phone, **changes))  # type: ignore[arg-type]

    return {
        "phone": Filmed(phone),
        "two loops": Filmed(phone, loops=2),
        "1/30 s": of(exposure_s=1 / 30),
        "1/120 s": of(exposure_s=1 / 120),
        "1/1000 s": of(exposure_s=1 / 1000),
        "readout 5 ms": of(readout_s=0.005),
        "readout 30 ms": of(readout_s=0.03),
        "clock −0.1 %": of(fast=-0.001),
        "24 fps, 1/24 s": of(rate=24.0, exposure_s=1 / 24),
        "24 fps, 1/24 s, 0.1 s": Filmed(replace(phone, rate=24.0, exposure_s=1 / 24), hold_s=0.1),
        "60 fps": of(rate=60.0, exposure_s=1 / 120),
        "59.94 fps": of(rate=60_000 / 1001, exposure_s=0.01, readout_s=0.012, fast=9e-6),
        "59.94 fps, upwards": of(rate=60_000 / 1001, exposure_s=0.01, readout_s=0.004, fast=9e-6),
        "240 fps": of(rate=240.0, exposure_s=1 / 480, readout_s=0.004),
        "10 Mbit/s": of(bit_rate=10e6),
        "100 Mbit/s": of(bit_rate=100e6),
        "HEVC": of(codec="libx265"),
        "HEVC, 10 bit": of(codec="libx265", ten_bit=True),
        "linear": of(tone="linear"),
        "filmic": of(tone="filmic"),
        "sharpened": of(sharpening=1.0),
        "dropped": of(dropped=(150, 151, 320)),
        "repeated": of(repeated=(150, 151, 250, 320)),
        "times ± 4 ms": of(jitter_s=0.004),
        "dimming": of(gain=dimming),
        "hunting exposure": of(gain=hunting),
        "shaking": of(motion=shaking),
        "stabilised": of(motion=stabilised),
        "settling": of(motion=settling),
        "a pause": of(pause=(8.0, 1.0)),
    }


def drawn(seed: int) -> Filmed:
    """A random camera and video."""
    rng = np.random.default_rng([seed, 40])
    rate = float(rng.choice([24.0, 25.0, 30.0, 30.0, 50.0, 60.0]))
    camera = Camera(
        rate=rate,
        exposure_s=float(min(1 / rate, np.exp(rng.uniform(np.log(1 / 1000), np.log(1 / 30))))),
        readout_s=float(rng.uniform(0.005, min(0.03, 0.95 / rate))),
        tone=str(rng.choice(["linear", "srgb", "bt709", "filmic"])),
        sharpening=float(rng.choice([0.0, 0.3, 0.6, 1.0])),
        codec=str(rng.choice(["libx264", "libx264", "libx265"])),
        bit_rate=float(np.exp(rng.uniform(np.log(10e6), np.log(100e6)))),
        ten_bit=bool(rng.random() < 0.2),
        fast=float(rng.uniform(-0.001, 0.001)),
        full_well=float(rng.choice([4000.0, 8000.0, 20_000.0])),
    )
    frames = tuple(int(number) for number in rng.integers(30, 250, 3))
    disturbed: list[dict[str, object]] = [
        {"dropped": frames},
        {"repeated": frames},
        {"jitter_s": 0.1 / rate},
        {"gain": dimming},
        {"gain": hunting},
        {"motion": shaking},
        {"motion": settling},
        {"pause": (float(rng.uniform(2, 10)), 0.7)},
    ]
    if rng.random() < 0.35:
        camera = replace(camera, **disturbed[rng.integers(len(disturbed))])  # type: ignore[arg-type]
    return Filmed(camera, hold_s=0.1 if rate >= 30 else 0.15)


def dimming(time_s: float) -> float:
    return 1 - 0.004 * time_s


def hunting(time_s: float) -> float:
    return 1 + 0.1 * float(np.sin(2 * time_s))


def shaking(time_s: float) -> tuple[float, float, float]:
    return 0.5 * float(np.sin(3 * time_s)), 0.3 * float(np.sin(5 * time_s)), 0.0


def stabilised(time_s: float) -> tuple[float, float, float]:
    """Shifts by electronic stabilisation of a camera on a vibrating table."""
    return 0.3 * float(np.sin(40 * time_s)), 0.3 * float(np.sin(50 * time_s)), 0.05 * float(np.sin(31 * time_s))


def settling(time_s: float) -> tuple[float, float, float]:
    """Slow motion, as by focus breathing or a sinking tripod."""
    return 0.02 * time_s, 0.03 * time_s, 0.0


@dataclass
class Stage:
    """A simulated room, with cached images of each picture."""

    room: SimulatedRoom
    seen: dict[bytes, Light]

    def light_of(self, picture: Image) -> Light:
        key = picture.tobytes()
        if key not in self.seen:
            self.seen[key] = self.room.electrons(picture) / np.float32(self.room.settings.full_well_electrons)
        return self.seen[key]


@dataclass(frozen=True)
class Outcome:
    """A row of the table; `sigmas` is None for a refused film, whose reason is `told`.

    `error_of_sigma`: root mean square of errors of matches over their sigmas, along the worse axis.
    """

    median_px: float | None
    error_of_sigma: float | None
    error_percent: float | None
    sigmas: float | None
    found: str
    told: str
    seconds: float


def judged(stage: Stage, programme: Programme, recording: Path, folder: Path) -> Outcome:
    begun = time.process_time()
    try:
        imported = import_recording(recording, programme, folder, Terminal(quiet=True))
    except InputError as error:
        why = str(error).removeprefix(f"{recording}: ")
        return Outcome(None, None, None, None, "", why, time.process_time() - begun)
    seconds = time.process_time() - begun
    clocks, height = imported.clocks, stage.room.renderer.shape[0]
    found = f"{exposure_text(clocks)}, {1e3 * clocks.line_s * height:.1f} ms, "
    found += f"{imported.frames_per_picture:.1f} frames"
    told = " ".join(map(str, imported.findings))
    truth, calibration = stage.room.ground_truth(), stage.room.calibration
    assert calibration is not None
    known = list(calibration.camera.principal_point_px)
    overrides = [f"camera.principal_point={{known: {known}}}", "corner.squareness_deg=0"]
    try:
        config = load_config(None, overrides)
        newest = replay(folder, folder.parent / "result", config=config, overwrite=True).newest
    except (InputError, RefusalError) as error:
        return Outcome(None, None, None, None, found, str(error), seconds)
    calibrated, matches = newest.calibration, newest.decoded.matches
    x, y = np.rint(matches.camera_px).astype(int).T
    error_px = matches.projector_px - truth.projector_px[y, x]
    median, of_sigma = float(np.nanmedian(np.linalg.norm(error_px, axis=1))), error_of_sigma(error_px, matches)
    errors = intrinsic_errors_percent(calibrated, calibration)
    return Outcome(median, of_sigma, float(np.abs(errors).mean()), most_sigmas(calibrated, stage), found, told, seconds)


def error_of_sigma(error_px: Floats, matches: Matches) -> float:
    """Root mean square of errors (n, 2) over sigmas along the worse axis, without wrong matches."""
    assert matches.sigma_px is not None
    relative = error_px / matches.sigma_px[:, None]
    relative = relative[(np.abs(relative) < WRONG_SIGMAS).all(axis=1)]
    return float(np.sqrt(np.mean(relative**2, axis=0)).max())


def most_sigmas(found: Calibration, stage: Stage) -> float:
    true = stage.room.calibration
    assert true is not None
    camera, projector = found.sigma.camera, found.sigma.projector
    assert camera.focal_px
    assert projector.focal_px
    assert projector.principal_point_px
    off = [
        (found.camera.focal_px[0] - true.camera.focal_px[0]) / camera.focal_px[0],
        (found.projector.focal_px[0] - true.projector.focal_px[0]) / projector.focal_px[0],
        (found.projector.principal_point_px[0] - true.projector.principal_point_px[0])
        / projector.principal_point_px[0],
        (found.projector.principal_point_px[1] - true.projector.principal_point_px[1])
        / projector.principal_point_px[1],
    ]
    return float(np.abs(off).max())


class Videos:
    """The players' videos of one sequence, written once for each hold and number of loops."""

    def __init__(self, folder: Path, preset: PresetName, size: tuple[int, int]) -> None:
        self._folder, self._patterns, self._size = folder, PRESETS[preset].patterns(size), Size(*size)
        self._kept: dict[tuple[float, int], tuple[Programme, Played]] = {}

    def of(self, filmed: Filmed) -> tuple[Programme, Played]:
        key = filmed.hold_s, filmed.loops
        if key not in self._kept:
            programme = programme_of(self._patterns, self._size, *key)
            path = self._folder / f"video-{key[0]:g}-{key[1]}.mp4"
            write_player_video(path, programme)
            self._kept[key] = programme, play(path)
        return self._kept[key]


def outcomes(
    seed: int, chosen: dict[str, Filmed], videos: Videos, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> Iterator[tuple[str, Outcome]]:
    stage = Stage(SimulatedRoom(SimulatedRigSettings(seed=seed), camera_size, projector_size), {})
    share = camera_size[0] * camera_size[1] / FULL_PIXELS
    for number, (name, filmed) in enumerate(chosen.items()):
        programme, played = videos.of(filmed)
        camera = replace(filmed.camera, bit_rate=share * filmed.camera.bit_rate, seed=1000 * seed + number)
        start_s = float(np.random.default_rng([seed, number]).uniform(0, 1.5))
        with tempfile.TemporaryDirectory() as folder:
            recording, capture = Path(folder) / "film.mp4", Path(folder) / "capture"
            capture.mkdir()
            pause = filmed.camera.pause[1] if filmed.camera.pause else 0.0
            film(recording, played, stage.light_of, camera, Clip(start_s, played.length_s - start_s + pause))
            yield name, judged(stage, programme, recording, capture)


def row(seed: int, name: str, outcome: Outcome) -> list[str]:
    def number(value: float | None, pattern: str) -> str:
        return "" if value is None else format(value, pattern)

    return [
        str(seed),
        name,
        number(outcome.median_px, ".3f"),
        number(outcome.error_of_sigma, ".2f"),
        number(outcome.error_percent, ".3f"),
        number(outcome.sigmas, ".1f"),
        outcome.found,
        f"{outcome.seconds:.0f}",
        outcome.told,
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, nargs="+", default=[0])
    parser.add_argument("--films", nargs="+", choices=list(films()), default=list(films()))
    parser.add_argument("--drawn", type=int, default=0, metavar="N", help="take this many random films instead")
    parser.add_argument("--width", type=int, default=640, metavar="PX", help="of the frames, a multiple of 32")
    options = parser.parse_args()
    camera_size = options.width, options.width * 9 // 16
    projector_size = (854, 480) if options.width == 1920 else (options.width * 2 // 3 & ~1, options.width * 3 // 8 & ~1)
    listed = {name: filmed for name, filmed in films().items() if name in options.films}
    rooms = [(seed, listed) for seed in options.rooms]
    if options.drawn:
        numbers = range(options.drawn)
        rooms = [
            (first // PER_ROOM, {f"{number}": drawn(number) for number in numbers[first : first + PER_ROOM]})
            for first in numbers[::PER_ROOM]
        ]
    table = Table(
        title=f"Films of {camera_size[0]} × {camera_size[1]}, projector {projector_size[0]} × {projector_size[1]}"
    )
    for column in (
        "room",
        "film",
        "median px",
        "of sigma",
        "error %",
        "sigmas",
        "exposure, readout, per picture",
        "CPU s",
        "told",
    ):
        table.add_column(column, justify="left" if column in ("film", "told") else "right")
    results = list[Outcome]()
    with tempfile.TemporaryDirectory() as folder:
        videos = Videos(Path(folder), "standard", projector_size)
        for seed, chosen in rooms:
            for name, outcome in outcomes(seed, chosen, videos, camera_size, projector_size):
                results.append(outcome)
                table.add_row(*row(seed, name, outcome))
                print(*row(seed, name, outcome), sep=" | ", flush=True)
    console = Console(width=200)
    console.print(table)
    sure = [outcome for outcome in results if outcome.sigmas is not None]
    wrong = sum(1 for outcome in sure if outcome.sigmas is not None and outcome.sigmas > MOST_SIGMAS)
    console.print(
        f"{len(results)} films: {len(sure)} calibrated, {len(results) - len(sure)} refused, {wrong} beyond 4 sigma"
    )


if __name__ == "__main__":
    main()
