"""Serve a camera that sees a simulated room, lit by one virtual screen or several, until standard input closes.

Started by `hw/loopback/launcher.py`. Prints 'ready' when the camera can be found, and again after each line of new
`Conditions` (JSON) from standard input.
"""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from math import prod
from pathlib import Path

from hw.errors import DeviceError
from hw.loopback.camera import LitRoom, LoopbackCamera, RoomSensor
from hw.loopback.screen import ScreenHistory, SeveralScreens, XwdScreen
from hw.loopback.settings import Conditions, LoopbackSettings
from hw.loopback.webcam import MjpegServer, Webcam

_ALBUM_BYTES = 1e8
_PUNCTUAL_S = 0.0005  # rendering must not delay an exposure


def main() -> int:
    """Serve; returns the exit code."""
    options = _options()
    settings = LoopbackSettings.model_validate_json(options.settings)
    sys.setswitchinterval(_PUNCTUAL_S)
    try:
        _serve(options.screen, settings)
    except (DeviceError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 3
    return 0


def _serve(screen_files: Sequence[Path], settings: LoopbackSettings) -> None:
    screens = [XwdScreen(file) for file in screen_files]
    room = LitRoom(settings, [screen.size for screen in screens])
    album = max(4, int(_ALBUM_BYTES / (4 * prod(settings.camera_size))))
    with ExitStack() as running:
        histories = [
            running.enter_context(
                ScreenHistory(screen, partial(room.electrons, number), settings.room.seed + number, album)
            )
            for number, screen in enumerate(screens)
        ]
        light, white_us = SeveralScreens(histories), settings.white_exposure_us
        if settings.webcam is None:
            sensor = RoomSensor(room.brightest, light, white_us)
            with LoopbackCamera(settings.address, settings.serial, settings.camera_size, sensor.expose) as camera:
                _obey(settings.conditions, histories, lambda conditions: camera.lose(conditions.lost_packets))
        else:
            with (
                MjpegServer(settings.address, settings.webcam.port, settings.webcam.queue) as server,
                Webcam(room.brightest, light, settings.webcam, white_us, server.send) as webcam,
            ):
                _obey(settings.conditions, histories, partial(setattr, webcam, "conditions"))


def _obey(conditions: Conditions, histories: Sequence[ScreenHistory], change: Callable[[Conditions], object]) -> None:
    """Set the conditions, then read new ones from standard input until it closes."""
    while True:
        for history in histories:
            history.wall.conditions = conditions
        change(conditions)
        print("ready", flush=True)
        line = sys.stdin.readline()
        if not line:
            return
        conditions = Conditions.model_validate_json(line)


def _options() -> Namespace:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument(
        "--screen", type=Path, required=True, action="append", help="file in which Xvfb keeps a screen; may be repeated"
    )
    parser.add_argument("--settings", required=True, help="LoopbackSettings as JSON")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
