"""Reconstruct from a recorded capture, also of another program."""

from argparse import Namespace
from pathlib import Path

from scanner import jobs
from scanner.capture import CAPTURE_FILE
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.io import given_path
from scanner.results import CAPTURE_FOLDER, default_out
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    terminal = Terminal(quiet=args.quiet)
    out = args.out or default_out(_name(args.capture), overwrite=args.overwrite)
    result = jobs.replay(
        args.capture,
        out,
        config=load_config(args.config, args.set),
        calibration=args.calibration,
        masks=args.masks,
        overwrite=args.overwrite,
        terminal=terminal,
    )
    show_outcome(result, out, terminal, args.require)


def _name(capture: Path) -> str:
    """The recording of a result is called `capture`, like all others: the result's name says more."""
    folder = given_path(capture)
    folder = folder.parent if folder.name == CAPTURE_FILE else folder
    return folder.parent.name if folder.name == CAPTURE_FOLDER else folder.name
