"""Reconstruct from a recorded capture, also of another program."""

from pathlib import Path

from scanner import jobs
from scanner.capture import CAPTURE_FILE
from scanner.commands.options_of_scans import ReplayCommand
from scanner.commands.outcome import show_outcome
from scanner.io import given_path
from scanner.results import CAPTURE_FOLDER
from scanner.ui import Terminal


def run(args: ReplayCommand) -> None:
    """Do the work. Raises InputError, RefusalError."""
    terminal = Terminal(quiet=args.output.quiet)
    out = args.output.place(_name(args.capture))
    result = jobs.replay(
        args.capture,
        out,
        config=args.settings.load(),
        calibration=args.calibration,
        masks=args.masks,
        overwrite=args.output.overwrite,
        terminal=terminal,
    )
    show_outcome(result, out, terminal, args.output.require)


def _name(capture: Path) -> str:
    """The recording of a result is called `capture`, like all others: the result's name says more."""
    folder = given_path(capture)
    folder = folder.parent if folder.name == CAPTURE_FILE else folder
    return folder.parent.name if folder.name == CAPTURE_FOLDER else folder.name
