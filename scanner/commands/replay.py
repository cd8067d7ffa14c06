"""Reconstruct from a recorded capture, whoever made it."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from calib.geometry import Calibration
from scanner import pipeline
from scanner.capture import Recording, open_capture
from scanner.commands import options
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.io import read_calibration
from scanner.reconstruction import read_captures, read_masks, refuse_impossible
from scanner.results import CAPTURE_FOLDER, default_out, new_result
from scanner.ui import Terminal


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="folder with a capture.yaml and its frames")
    options.add_config(parser, required=False)
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="known calibration of the rig: nothing is calibrated"
    )
    options.add_masks(parser)
    options.add_out(parser, default="scans/<name of the capture>")
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    if args.masks and args.calibration:
        raise InputError("--masks says where to calibrate and --calibration that there is no need to: give one of them")
    config = load_config(args.config, args.set)
    recording = open_capture(args.capture)
    config.principal_point(recording.camera_size)
    masks = read_masks(args.masks, recording.camera_size) if args.masks else None
    calibration = read_calibration(args.calibration) if args.calibration else None
    if calibration:
        _check_sizes(args.calibration, calibration, recording)
        if config.earlier:
            raise InputError(
                "'earlier' says what to calibrate together with, and --calibration that there is no need to: give one "
                "of them, as with --set earlier=[]"
            )
    earlier = read_captures(config.earlier, recording.camera_size, recording.projector_size)
    refuse_impossible(config, len(earlier) + 1)
    out = args.out or default_out(_name(recording.folder), overwrite=args.overwrite)
    terminal = Terminal(quiet=args.quiet)
    with new_result(out, config, overwrite=args.overwrite) as folder:
        scan = pipeline.replay(
            recording, config, folder, terminal, masks=masks, calibration=calibration, earlier=earlier
        )
    show_outcome(scan, out, terminal)


def _name(capture: Path) -> str:
    """The recording of a result is called `capture`, like all others: the result's name says more."""
    folder = capture.resolve()
    return folder.parent.name if folder.name == CAPTURE_FOLDER else folder.name


def _check_sizes(path: Path, calibration: Calibration, recording: Recording) -> None:
    for name, device, expected in (
        ("camera", calibration.camera, recording.camera_size),
        ("projector", calibration.projector, recording.projector_size),
    ):
        if (device.width, device.height) != expected:
            raise InputError(
                f"{path}: its {name} is {device.width} × {device.height}, but the capture's is "
                f"{expected[0]} × {expected[1]}: this calibration belongs to another rig"
            )
