"""Scan with the configured rig: capture, calibrate, reconstruct."""

from argparse import Namespace

from scanner import jobs
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.results import default_out
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError."""
    config = load_config(args.config, args.set)
    terminal = Terminal(quiet=args.quiet)
    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    found = jobs.scan(
        config, out, captures=args.captures, masks=args.masks, overwrite=args.overwrite, terminal=terminal
    )
    show_outcome(found, out, terminal)
