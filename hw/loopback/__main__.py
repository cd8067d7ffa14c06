"""Serve a camera that sees a simulated room, lit by a virtual screen, until standard input closes.

    python -m hw.loopback --screen /tmp/xvfb/Xvfb_screen0 --camera 612x512

Prints 'ready' when it can be found.
"""

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from hw.errors import DeviceError
from hw.loopback.camera import LoopbackCamera
from hw.loopback.exposure import RoomSensor
from hw.loopback.launcher import LoopbackSettings
from hw.loopback.screen import ScreenHistory, XwdScreen
from hw.simulated.simulation import SimulatedRoom


def main() -> int:
    """Serve; returns the exit code."""
    options = _options()
    settings = LoopbackSettings.model_validate_json(options.settings)
    try:
        _serve(options.screen, settings)
    except (DeviceError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 3
    return 0


def _serve(screen_file: Path, settings: LoopbackSettings) -> None:
    screen = XwdScreen(screen_file)
    room = SimulatedRoom(settings.room, settings.camera_size, screen.size)
    with ScreenHistory(screen, room.electrons) as history:
        sensor = RoomSensor(room, history, settings.latency_ms / 1e3, settings.white_exposure_us)
        with LoopbackCamera(
            settings.address, settings.serial, settings.camera_size, sensor.expose, settings.lost_packets
        ):
            print("ready", flush=True)
            sys.stdin.read()  # whoever started us holds the other end, and its end is ours


def _options() -> Namespace:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--screen", type=Path, required=True, help="file in which Xvfb keeps its screen")
    parser.add_argument("--settings", required=True, help="LoopbackSettings as JSON")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
