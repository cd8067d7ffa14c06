"""Time per frame beyond its exposure, pipelined and sequential.

    python benchmarks/bench_overhead.py
    python benchmarks/bench_overhead.py --camera stream

On the loopback rig, with a whole sequence (default: standard), recorded and decoded as in a scan. With `quick` and
`concave`, the pictures that verify bits without inverses count towards each frame. Both modes alternate on the same
rig, so that other load affects both; "of limit" is the ratio to the limit, 1.3 exposures. Sequential comes first:
rendering a new picture takes a processor 25 ms, and the loopback camera caches it; a real rig has no such load. Also
measured: the response time to Ctrl-C, and the memory that scans leave allocated. With a streaming camera, the limit is
its latency (from a swap until a frame may show the picture) plus two frame periods, for the mean of 2 frames per
picture and of 4. Needs what `make rig` installs, and an idle machine.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import cast
from urllib.parse import urlsplit

from hw.ahead import in_background
from hw.errors import DeviceError
from hw.loopback import Conditions, LoopbackSettings, WebcamSettings, loopback_rig
from hw.open_rig import open_rig
from hw.opencv import OpenCVRigSettings
from hw.rig import Rig
from hw.timing import StreamedRig, SynchronisedRig
from scanner.capture import capture, record
from scanner.configuration import Config, load_config
from scanner.decoding import Decoder
from scanner.patterns import PRESETS

CONFIG = Path("configs/room-loopback.yaml")
STREAM_CONFIG = Path("configs/room-loopback-stream.yaml")
LIMIT = 1.3  # exposures


def decode(rig: Rig, config: Config, folder: Path) -> None:
    """Record and decode a capture as in a scan."""
    patterns = config.sequence.patterns(config.projector_size)
    stream = record(capture(rig, patterns), folder)
    decoder = Decoder(patterns, config.projector_size)
    with in_background(decoder.add) as add:
        for _, frame in stream.frames:
            add(frame.image)


def one_capture(rig: SynchronisedRig, config: Config, folder: Path) -> tuple[float, str]:
    """Milliseconds per frame, and a line about them."""
    decode(rig, config, folder)
    found = cast(dict[str, float], rig.account()["synchronisation"])
    exposures = found["ms_per_frame"] / 1e3 / rig.sequential.exposure_s
    apart = "" if rig.pipelined is None else f" (at last {1e3 * rig.pipelined.period_s:.1f} ms apart)"
    return exposures, (
        f"{found['ms_per_frame']:6.1f} ms a frame{apart}, {exposures:.2f} exposures, {exposures / LIMIT:.2f} of limit; "
        f"{found['retriggered_frames']} retaken, {found.get('missed_in_flight', 0)} missed, "
        f"{found.get('doubted_frames', 0)} doubted, computer late by {found.get('waited_for_computer_s', 0)} s"
    )


def interruption(folder: Path) -> float:
    """Seconds from SIGINT during a capture to the end of the process."""
    command = [sys.executable, "-m", "scanner", "--config", str(CONFIG), "--out", str(folder / "result"), "--quiet"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    while len(list(folder.glob(".result*/capture/frames/*.png"))) < 10:
        time.sleep(0.005)
    begin = time.perf_counter()
    process.send_signal(signal.SIGINT)
    process.wait()
    return time.perf_counter() - begin


def memory_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--latencies-ms", type=float, nargs="+", default=[20.0, 50.0, 120.0])
    parser.add_argument("--scans", type=int, default=3, help="captures at each latency, each both ways")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="standard")
    parser.add_argument("--camera", choices=["gige", "stream"], default="gige")
    options = parser.parse_args()
    overrides = [f"sequence.preset={options.preset}"]
    try:
        if options.camera == "stream":
            measure_stream(load_config(STREAM_CONFIG, overrides), options.latencies_ms, options.scans)
        else:
            measure(load_config(CONFIG, overrides), options.latencies_ms, options.scans)
    except DeviceError as error:
        print(f"not measured: {error}")


def measure(config: Config, latencies_ms: list[float], scans: int) -> None:
    for number, latency_ms in enumerate(latencies_ms):
        settings = LoopbackSettings(camera_size=config.camera_size, conditions=Conditions(latency_ms=latency_ms))
        with loopback_rig(settings, config.projector_size), tempfile.TemporaryDirectory() as folder:
            found: dict[str, list[float]] = {"sequential": [], "pipelined": []}
            for scan in range(scans):
                with open_rig(config.required_rig, config.camera_size, config.projector_size) as opened:
                    rig = cast(SynchronisedRig, opened.rig)
                    flying = "not at all" if rig.pipelined is None else f"{rig.pipelined.rhythm.outstanding} at once"
                    for way, used in (("sequential", replace(rig, verified=None)), ("pipelined", rig)):
                        exposures, line = one_capture(used, config, Path(folder) / f"{way} {scan}")
                        found[way].append(exposures)
                        print(f"latency {latency_ms:3.0f} ms, {way} ({flying}): {line}", flush=True)
            for way, each in found.items():
                print(f"latency {latency_ms:3.0f} ms, {way}: best {min(each):.2f}, median {median(each):.2f} exposures")
            print(f"load {os.getloadavg()[0]:.1f}, memory {memory_mb():.0f} MB")
            if number == 0:
                print(f"Ctrl-C: the process has ended after {interruption(Path(folder)):.2f} s", flush=True)


def measure_stream(config: Config, latencies_ms: list[float], scans: int) -> None:
    settings = cast(OpenCVRigSettings, config.required_rig)
    webcam = WebcamSettings(port=urlsplit(str(settings.camera)).port or 80)
    for latency_ms in latencies_ms:
        conditions = Conditions(latency_ms=latency_ms, sending_jitter_ms=8)
        loopback = LoopbackSettings(camera_size=config.camera_size, conditions=conditions, webcam=webcam)
        with loopback_rig(loopback, config.projector_size), tempfile.TemporaryDirectory() as folder:
            for scan in range(scans):
                for average in (2, 4):
                    averaging = settings.model_copy(update={"average": average})
                    with open_rig(averaging, config.camera_size, config.projector_size) as opened:
                        line = one_stream(cast(StreamedRig, opened.rig), config, Path(folder) / f"{average} {scan}")
                    print(f"latency {latency_ms:3.0f} ms, mean of {average}: {line}", flush=True)
        print(f"load {os.getloadavg()[0]:.1f}, memory {memory_mb():.0f} MB")


def one_stream(rig: StreamedRig, config: Config, folder: Path) -> str:
    """A capture of a stream, and a line about its time per picture."""
    decode(rig, config, folder)
    timing, seconds = rig.timing, rig.tally.seconds_per_frame
    limit_s = timing.soonest_s + 2 * timing.period_s
    found = cast(dict[str, float], rig.account()["synchronisation"])
    return (
        f"{seconds:.3f} s a picture, {seconds / limit_s:.2f} of the limit of {limit_s:.3f} s; frames every "
        f"{1e3 * timing.period_s:.1f} ms, {found['dropped_frames']} dropped, {found['retriggered_frames']} retaken"
    )


if __name__ == "__main__":
    main()
