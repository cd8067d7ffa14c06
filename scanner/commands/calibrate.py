"""Calibrate from matches of another decoder or of earlier results: one capture, or several of one rig at once."""

from argparse import Namespace

from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.jobs import calibrate
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    terminal = Terminal(quiet=args.quiet)
    config = load_config(args.config, args.set)
    result = calibrate(args.matches, config, args.out, overwrite=args.overwrite, terminal=terminal)
    show_outcome(result, args.out, terminal, args.require)
