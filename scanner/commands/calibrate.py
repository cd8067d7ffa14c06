"""Calibrate from matches of another decoder or of earlier results: one capture, or several of one rig at once."""

from scanner.commands.options_of_scans import CalibrateCommand
from scanner.commands.outcome import show_outcome
from scanner.jobs import calibrate
from scanner.ui import Terminal


def run(args: CalibrateCommand) -> None:
    """Do the work. Raises InputError, RefusalError."""
    terminal = Terminal(quiet=args.output.quiet)
    config = args.settings.load()
    out = args.output.place()
    result = calibrate(args.matches, config, out, overwrite=args.output.overwrite, terminal=terminal)
    show_outcome(result, out, terminal, args.output.require)
