"""Scan with the configured rig: capture, calibrate, reconstruct; or take up a scan that was broken off."""

from pathlib import Path

from scanner import jobs
from scanner.commands.options_of_scans import ObjectCommand, RoomCommand, ScanCommand
from scanner.commands.outcome import show_outcome
from scanner.errors import InputError
from scanner.ui import Terminal


def run(args: ScanCommand) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError."""
    if args.resume:
        _resume(args.resume, args)
    elif args.object or args.fill or args.calibration:
        if not args.object or args.stations is None or args.captures != 1 or args.masks:
            raise InputError(
                "a thing is scanned with --object --stations N [--calibration FILE], without --captures and --masks"
            )
        ObjectCommand(
            stations=args.stations,
            settings=args.settings,
            calibration=args.calibration,
            fill=args.fill,
            output=args.output,
        ).run()
    elif args.stations is not None:
        if args.captures != 1 or args.masks:
            raise InputError(
                "--stations scans a whole room; --captures and --masks are for one corner: give one of them"
            )
        RoomCommand(stations=args.stations, settings=args.settings, output=args.output).run()
    else:
        _scan(args)


def _scan(args: ScanCommand) -> None:
    terminal, config = Terminal(quiet=args.output.quiet), args.settings.load()
    out = args.output.place(args.settings.file.stem)
    result = jobs.scan(
        config, out, captures=args.captures, masks=args.masks, overwrite=args.output.overwrite, terminal=terminal
    )
    show_outcome(result, out, terminal, args.output.require)


def _resume(folder: Path, args: ScanCommand) -> None:
    if args.captures != 1:
        raise InputError("--resume completes one capture, and --captures takes several: give one of them")
    terminal, config = Terminal(quiet=args.output.quiet), args.settings.load() if args.settings.config else None
    result, out = jobs.resume(
        folder,
        args.output.out,
        config=config,
        overrides=args.settings.set,
        masks=args.masks,
        overwrite=args.output.overwrite,
        terminal=terminal,
    )
    show_outcome(result, out, terminal, args.output.require)
