"""Scan with the configured rig: capture, calibrate, reconstruct; or take up a scan that was broken off."""

from argparse import Namespace

from scanner import jobs
from scanner.commands.arguments import NAMED
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.results import default_out
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError."""
    if args.resume:
        _resume(args)
    elif args.object or args.fill or args.calibration:
        if not args.object or args.stations is None or args.captures != 1 or args.masks:
            raise InputError(
                "a thing is scanned with --object --stations N [--calibration FILE], without --captures and --masks"
            )
        NAMED["object"].load()(args)
    elif args.stations is not None:
        if args.captures != 1 or args.masks:
            raise InputError(
                "--stations scans a whole room; --captures and --masks are for one corner: give one of them"
            )
        NAMED["room"].load()(args)
    else:
        _scan(args)


def _scan(args: Namespace) -> None:
    terminal, config = Terminal(quiet=args.quiet), load_config(args.config, args.set)
    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    result = jobs.scan(
        config, out, captures=args.captures, masks=args.masks, overwrite=args.overwrite, terminal=terminal
    )
    show_outcome(result, out, terminal, args.require)


def _resume(args: Namespace) -> None:
    if args.captures != 1:
        raise InputError("--resume completes one capture, and --captures takes several: give one of them")
    terminal, config = Terminal(quiet=args.quiet), load_config(args.config, args.set) if args.config else None
    result, out = jobs.resume(
        args.resume,
        args.out,
        config=config,
        overrides=args.set,
        masks=args.masks,
        overwrite=args.overwrite,
        terminal=terminal,
    )
    show_outcome(result, out, terminal, args.require)
