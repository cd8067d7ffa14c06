"""Scan with the loopback rig: start a virtual screen and a camera that sees it, scan, compare with the truth.

    python tools/scan_loopback.py --config configs/room-loopback.yaml --out scans/room-loopback --overwrite

The scan is the command that a real rig is scanned with. The truth is written into its result afterwards.
"""

import os
import subprocess
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from hw.errors import DeviceError
from hw.loopback.launcher import loopback_rig
from hw.loopback.settings import Conditions, LoopbackSettings
from hw.settings import SimulatedRigSettings
from hw.simulated.simulation import place_room
from hw.simulated.truth import true_calibration
from scanner.configuration import load_config
from scanner.io import read_calibration, write_calibration
from scanner.quantities import truth_line
from scanner.results import CALIBRATION_FILE, TRUTH_FILE


def main() -> int:
    """Scan; returns the exit code of the scan."""
    options = _options()
    config = load_config(options.config)
    settings = LoopbackSettings(
        camera_size=config.camera_size,
        room=SimulatedRigSettings(seed=options.seed),
        conditions=Conditions(latency_ms=options.latency_ms, lost_packets=options.lost_packets),
    )
    command = [sys.executable, "-m", "scanner", "--config", str(options.config), "--out", str(options.out)]
    try:
        with loopback_rig(settings, config.projector_size):
            code = subprocess.run(command + ["--overwrite"] * options.overwrite, check=False).returncode
    except DeviceError as error:
        print(error, file=sys.stderr)
        return 3
    if code == 0:
        truth = true_calibration(place_room(settings.room, config.camera_size, config.projector_size))
        if truth is None:
            return code
        write_calibration(options.out / TRUTH_FILE, truth)
        print(truth_line(read_calibration(options.out / CALIBRATION_FILE), truth))
    return code


def _options() -> Namespace:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--overwrite", action="store_true")
    parser.add_argument("--seed", type=int, default=0, help="of the room (default: 0)")
    parser.add_argument("--latency-ms", type=float, default=50.0, help="of the projector's light (default: 50)")
    parser.add_argument("--lost-packets", type=float, default=0.0, help="share of the camera's packets (default: 0)")
    return parser.parse_args()


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
