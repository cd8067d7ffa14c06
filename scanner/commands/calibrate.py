"""Calibrate from matches of another decoder or of earlier results: one capture, or several of one rig at once."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from scanner import pipeline
from scanner.commands import options
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.reconstruction import read_captures, refuse_impossible
from scanner.results import new_result
from scanner.ui import Terminal


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "matches",
        type=Path,
        nargs="+",
        metavar="MATCHES",
        help="matches.npz, or a result folder; several of one unchanged rig are calibrated together, the newest last",
    )
    options.add_config(parser, required=True)
    options.add_out(parser)
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    config = load_config(args.config, args.set)
    config.principal_point(config.camera_size)
    captures = read_captures(args.matches, config.camera_size, config.projector_size)
    refuse_impossible(config, len(captures))
    terminal = Terminal(quiet=args.quiet)
    with new_result(args.out, config, overwrite=args.overwrite) as folder:
        scan = pipeline.calibrate(captures, config, folder, terminal)
    show_outcome(scan, args.out, terminal)
