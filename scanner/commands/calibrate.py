"""Calibrate from matches of another decoder or of earlier results: one capture, or several of one rig at once."""

from argparse import Namespace

from scanner import pipeline
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.reconstruction import read_captures, refuse_impossible
from scanner.results import new_result
from scanner.ui import Terminal


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
