"""Scan with the configured rig: capture, calibrate, reconstruct; or take up a scan that was broken off."""

from argparse import Namespace

from scanner import jobs
from scanner.commands.outcome import show_outcome
from scanner.configuration import Config, load_config
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
    if args.object or args.fill or args.calibration:
        _object(args, config, terminal)
        return
    if args.stations is not None:
        _room(args, config, terminal)
        return
    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    found = jobs.scan(
        config, out, captures=args.captures, masks=args.masks, overwrite=args.overwrite, terminal=terminal
    )
    show_outcome(found, out, terminal)


def _object(args: Namespace, config: Config, terminal: Terminal) -> None:
    if not args.object or args.calibration is None or args.stations is None or args.captures != 1 or args.masks:
        raise InputError(
            "a thing is scanned with --object --stations N --calibration FILE, without --captures and --masks"
        )
    from scanner.commands.object import show_object
    from scanner.objects.jobs import scan_object

    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    found = scan_object(
        config,
        out,
        calibration=args.calibration,
        number=args.stations,
        fill=args.fill,
        overwrite=args.overwrite,
        terminal=terminal,
    )
    show_object(*found, out, terminal)


def _room(args: Namespace, config: Config, terminal: Terminal) -> None:
    if args.captures != 1 or args.masks:
        raise InputError("--stations scans a whole room; --captures and --masks are for one corner: give one of them")
    from scanner.commands.room import show_room  # imports Open3D and DXF, which nothing else here needs
    from scanner.rooms.jobs import scan_room

    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    show_room(scan_room(config, out, number=args.stations, overwrite=args.overwrite, terminal=terminal), out, terminal)


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
    show_outcome(found, out, terminal, [f"The frames that {args.resume} holds are in this result, too."])
