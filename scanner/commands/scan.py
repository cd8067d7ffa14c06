"""Scan with the configured rig: capture, calibrate, reconstruct."""

from argparse import ArgumentParser, Namespace

from scanner import pipeline
from scanner.capture import check_places
from scanner.commands import options
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.reconstruction import read_captures, read_masks, refuse_impossible
from scanner.results import default_out, new_result
from scanner.ui import Terminal


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    options.add_config(parser, required=True)
    parser.add_argument(
        "--captures",
        type=int,
        default=1,
        metavar="N",
        help="capture the corner N times, moving the rig as a whole in between, and calibrate from all (default: 1)",
    )
    options.add_out(parser, default="scans/<name of the configuration>")
    options.add_overwrite(parser)
    options.add_masks(parser)
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError."""
    config = load_config(args.config, args.set)
    terminal = Terminal(quiet=args.quiet)
    # Whatever could be refused after the capture is asked before it.
    config.principal_point(config.camera_size)
    if args.captures < 1:
        raise InputError(f"--captures: expected 1 or more, found {args.captures}")
    if args.masks and args.captures > 1:
        raise InputError("--masks are of one view of the corner, and --captures takes several: give one of them")
    masks = read_masks(args.masks, config.camera_size) if args.masks else None
    check_places(config.required_rig, args.captures, terminal)
    earlier = read_captures(config.earlier, config.camera_size, config.projector_size)
    refuse_impossible(config, len(earlier) + args.captures)
    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    with new_result(out, config, overwrite=args.overwrite, keep_capture=True) as folder:
        scan = pipeline.scan(config, folder, terminal, number=args.captures, masks=masks, earlier=earlier)
    show_outcome(scan, out, terminal)
