"""Scan with the configured rig: capture, calibrate, reconstruct; or take up a scan that was broken off."""

from argparse import Namespace

from scanner import jobs
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.results import default_out
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError."""
    terminal = Terminal(quiet=args.quiet)
    if args.resume:
        _resume(args, terminal)
        return
    config = load_config(args.config, args.set)
    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    found = jobs.scan(
        config, out, captures=args.captures, masks=args.masks, overwrite=args.overwrite, terminal=terminal
    )
    show_outcome(found, out, terminal)


def _resume(args: Namespace, terminal: Terminal) -> None:
    if args.captures != 1:
        raise InputError("--resume completes one capture, and --captures takes several: give one of them")
    config = load_config(args.config, args.set) if args.config else None
    found, out = jobs.resume(
        args.resume,
        args.out,
        config=config,
        overrides=args.set,
        masks=args.masks,
        overwrite=args.overwrite,
        terminal=terminal,
    )
    show_outcome(found, out, terminal)
    terminal.show(f"The frames that {args.resume} holds are in this result, too.")
