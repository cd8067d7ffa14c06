"""What a capture costs over the unavoidable: exposure and the projector's latency, for every pattern.

    python benchmarks/bench_overhead.py

On the loopback rig, with a whole standard sequence, recorded and decoded as in a scan. Also: how soon Ctrl-C answers,
and what a scan leaves behind in memory. Needs what `make rig` installs, and a machine with nothing else to do.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hw.errors import DeviceError
from hw.loopback.launcher import loopback_rig
from hw.loopback.settings import Conditions, LoopbackSettings
from hw.open_rig import open_rig
from scanner.capture import capture, record
from scanner.configuration import Config, load_config
from scanner.decoding import Decoder

CONFIG = Path("configs/room-loopback.yaml")


def one_capture(config: Config, folder: Path) -> str:
    patterns = config.sequence.patterns(config.projector_size)
    with open_rig(config.required_rig, config.camera_size, config.projector_size) as opened:
        stream = record(capture(opened.rig, patterns), folder)
        decoder = Decoder(patterns, config.projector_size)
        for _, frame in stream.frames:
            decoder.add(frame.image)
        found = opened.rig.account()["synchronisation"]
    return (
        f"{len(patterns)} patterns, {found['ms_per_frame']:.1f} ms each: "
        f"exposure {1e3 * opened.rig.turns.exposure_s:.1f}, latency {found['latency_ms']:.1f}, "
        f"overhead {found['overhead_percent']:.1f} %, {found['retriggered_frames']} retriggered"
    )


def interruption(folder: Path) -> float:
    """Seconds from SIGINT amid a capture to the end of the process."""
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
    parser.add_argument("--latencies-ms", type=float, nargs="+", default=[50.0, 120.0, 20.0])
    parser.add_argument("--scans", type=int, default=5, help="captures at the first latency")
    options = parser.parse_args()
    config = load_config(CONFIG)
    try:
        measure(config, options.latencies_ms, options.scans)
    except DeviceError as error:
        print(f"not measured: {error}")


def measure(config: Config, latencies_ms: list[float], scans: int) -> None:
    for number, latency_ms in enumerate(latencies_ms):
        settings = LoopbackSettings(camera_size=config.camera_size, conditions=Conditions(latency_ms=latency_ms))
        with loopback_rig(settings, config.projector_size), tempfile.TemporaryDirectory() as folder:
            for scan in range(scans if number == 0 else 1):
                line = one_capture(config, Path(folder) / f"capture{scan}")
                print(f"latency {latency_ms:.0f} ms: {line}; memory {memory_mb():.0f} MB", flush=True)
            if number == 0:
                print(f"Ctrl-C: the process has ended after {interruption(Path(folder)):.2f} s", flush=True)


if __name__ == "__main__":
    main()
