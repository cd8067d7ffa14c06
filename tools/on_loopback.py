"""Run a command on the loopback rig: start a virtual screen and a camera that sees it, then the command.

    python tools/on_loopback.py scan --config configs/room-loopback.yaml --out scans/room-loopback --overwrite
    python tools/on_loopback.py scan check --config configs/room-loopback.yaml
    python tools/on_loopback.py --latency-ms 120 scan console --config configs/room-loopback.yaml
    python tools/on_loopback.py scan --config configs/room-loopback-stream.yaml --out scans/room-loopback-stream
    python tools/on_loopback.py scan network --config configs/hall-loopback.yaml --out scans/hall-loopback

The command is the one that a real rig is used with; a configuration with `backend: opencv` gets a webcam at the address
that it names, and a network a camera and a screen for each name. After a scan the truth is written into its result.
"""

import os
import subprocess
import sys
from argparse import REMAINDER, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from hw.backends import RigSettings
from hw.errors import DeviceError
from hw.loopback.launcher import loopback_network, loopback_rig, own_addresses
from hw.loopback.settings import Conditions, LoopbackSettings, WebcamSettings
from hw.opencv import OpenCVRigSettings
from hw.settings import SimulatedRigSettings
from hw.simulated.simulation import place_room, true_calibration
from scanner.commands import NAMED
from scanner.configuration import Config, load_config
from scanner.io import read_calibration, write_calibration
from scanner.quantities import truth_line
from scanner.results import CALIBRATION_FILE, TRUTH_FILE
from scanner.ui import Terminal


def main() -> int:
    """Run the command; returns its exit code."""
    options = _parser().parse_args()
    program, *command = options.command or [""]
    given = _options_of(command)
    if program != "scan" or given.config is None:
        print("expected a command such as: scan check --config configs/room-loopback.yaml", file=sys.stderr)
        return 2
    config = load_config(given.config)
    settings = LoopbackSettings(
        camera_size=config.camera_size,
        room=SimulatedRigSettings(seed=options.seed),
        conditions=Conditions(**{name: getattr(options, name) for name in Conditions.model_fields}),
        webcam=_webcam(config.required_rig),
    )
    try:
        with _devices(config, settings) as more:
            code = subprocess.run([sys.executable, "-m", "scanner", *command, *more], check=False).returncode
    except DeviceError as error:
        print(error, file=sys.stderr)
        return 3
    except KeyboardInterrupt:  # the command has had it, too, and said so
        return 130
    if code == 0 and given.out and command[0] not in NAMED:
        truth = true_calibration(place_room(settings.room, config.camera_size, config.projector_size))
        if truth is not None:
            write_calibration(given.out / TRUTH_FILE, truth)
            Terminal().show(truth_line(read_calibration(given.out / CALIBRATION_FILE), truth))
    return code


@contextmanager
def _devices(config: Config, settings: LoopbackSettings) -> Iterator[list[str]]:
    """Run the devices that a configuration names. Returns options by which the command finds those of a network."""
    if config.rigs is None:
        with loopback_rig(settings, config.projector_size):
            yield []
        return
    pairs, addresses = config.pairs, own_addresses()
    cameras = {camera: own.camera_size for (camera, _), own in pairs.items()}
    projectors = {projector: own.projector_size for (_, projector), own in pairs.items()}
    if len(cameras) > len(addresses):
        raise DeviceError(f"{len(cameras)} cameras need as many addresses; this computer has {', '.join(addresses)}")
    found = dict(zip(cameras, addresses, strict=False))
    served = [
        settings.model_copy(
            update={
                "camera_size": size,
                "room": settings.room.model_copy(update={"pose": pose}),
                "projector_poses": tuple(range(len(projectors))),
                "address": found[camera],
                "serial": camera,
            }
        )
        for pose, (camera, size) in enumerate(cameras.items())
    ]
    with loopback_network(served, [*projectors.values()]) as screens:
        of_cameras = [f"rigs.cameras.{name}.rig.camera={address}" for name, address in found.items()]
        of_projectors = [
            f"rigs.projectors.{name}.rig.screen={screen.display}"
            for name, screen in zip(projectors, screens, strict=True)
        ]
        yield [word for each in (*of_cameras, *of_projectors) for word in ("--set", each)]


def _parser() -> ArgumentParser:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter, allow_abbrev=False)
    parser.add_argument("--seed", type=int, default=0, help="of the room (default: 0)")
    for name, field in Conditions.model_fields.items():
        text = f"{field.description} (default: {field.default!r})".replace("%", "%%")
        kind = str if name == "fault" else float  # pydantic makes of a number what the field is, and refuses others
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, default=field.default, help=text)
    parser.add_argument("command", nargs=REMAINDER, metavar="scan ...", help="any command with --config FILE")
    return parser


def _webcam(rig: RigSettings) -> WebcamSettings | None:
    """The one at the address of the configuration, if that has one."""
    if not isinstance(rig, OpenCVRigSettings):
        return None
    return WebcamSettings(port=urlsplit(str(rig.camera)).port or 80)


def _options_of(command: list[str]) -> Namespace:
    """What of the command's own options matters here."""
    parser = ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config", type=Path)
    parser.add_argument("--out", type=Path)
    return parser.parse_known_args(command)[0]


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
