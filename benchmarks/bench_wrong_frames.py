"""Whether a frame of a wrong picture is ever accepted: scans on the loopback rig while the processors are busy.

    python benchmarks/bench_wrong_frames.py [--scans 20] [--busy 4] [--latency-ms 50]

Each of the 52 frames of a scan is compared with the simulated camera's view of its pattern at rest, and with the
patterns before and after it: at most 2 % of a frame may be of those. The wall has jitter, and sometimes misses a
refresh, which neither projector nor camera report. `--without-inverses`: 39 frames, verified by parity.
Needs what `make rig` installs.
"""

import os
import subprocess
import sys
import tempfile
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from hw.errors import DeviceError
from hw.loopback import Conditions, LoopbackSettings, loopback_rig
from hw.open_rig import open_rig
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner.capture import capture, open_capture, record
from scanner.configuration import Config
from scanner.io import parse_yaml
from scanner.patterns import sequence_for

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.loopback_bench import CAMERA, CONFIG, PROJECTOR, wrong_frames

_BUSY = "while True: sum(range(100000))"


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Run this many busy processes."""
    with ExitStack() as processes:
        for _ in range(count):
            process = processes.enter_context(subprocess.Popen([sys.executable, "-c", _BUSY]))
            processes.callback(process.kill)
        yield


def main() -> int:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=20)
    parser.add_argument("--busy", type=int, default=4, help="processes that compute meanwhile")
    parser.add_argument("--latency-ms", type=float, default=50.0)
    parser.add_argument("--jitter-ms", type=float, default=1.0)
    parser.add_argument("--without-inverses", action="store_true")
    parser.add_argument("--missed", type=float, default=0.01, help="share of the pictures that come a refresh late")
    options = parser.parse_args()
    inverses = not options.without_inverses
    patterns = sequence_for(PROJECTOR, code="gray", cell=4, inverses=inverses, periods=(16.0, 11.3, 6.7), shifts=4)
    config = Config.model_validate(parse_yaml(CONFIG, "the rig"))
    conditions = Conditions(latency_ms=options.latency_ms, jitter_ms=options.jitter_ms, missed_refreshes=options.missed)
    room = SimulatedRoom(SimulatedRigSettings(seed=0), CAMERA, PROJECTOR)
    frames = wrong = refused = 0
    with (
        loopback_rig(LoopbackSettings(camera_size=CAMERA, conditions=conditions), PROJECTOR),
        busy(options.busy),
        tempfile.TemporaryDirectory() as folder,
    ):
        for scan in range(options.scans):
            recorded = Path(folder) / str(scan)
            try:
                with open_rig(config.required_rig, CAMERA, PROJECTOR) as opened:
                    for _ in record(capture(opened.rig, patterns), recorded).frames:
                        pass
                    account = opened.rig.account()["synchronisation"]
            except DeviceError as error:
                refused += 1
                print(f"scan {scan + 1}: {error}", flush=True)
                continue
            found = wrong_frames(open_capture(recorded), room)
            frames, wrong = frames + len(patterns), wrong + len(found)
            print(f"scan {scan + 1}: {len(patterns)} frames, {len(found)} wrong {found}; {account}", flush=True)
    print(f"{wrong} of {frames} frames wrong, {refused} scans refused; load {os.getloadavg()[0]:.1f}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
