"""Calibrate several cameras and projectors together, from captures of their pairs."""

from scanner.commands.options_of_scans import NetworkCommand
from scanner.commands.outcome import conclude
from scanner.errors import InputError
from scanner.networks import KnownDistance, scan_network, verdict_on
from scanner.results import NETWORK_CLOUD_FILE, NETWORK_FILE, REPORT_FILE
from scanner.ui import Terminal


def run(args: NetworkCommand) -> None:
    """Do the work. Raises InputError, RefusalError, GradeError."""
    terminal = Terminal(quiet=args.output.quiet)
    out = args.output.place("network")
    known = KnownDistance.parse(args.distance) if args.distance else None
    config = args.settings.load()
    if not args.captures and args.settings.config is None:
        raise InputError("give captures of pairs, or --config FILE with the devices to take them")
    if args.captures and args.stations is not None:
        raise InputError(
            "--stations captures with the devices of --config; captures that exist are of stations already"
        )
    solved = scan_network(
        config,
        out,
        folders=args.captures,
        stations=1 if args.stations is None else args.stations,
        known=known,
        overwrite=args.output.overwrite,
        terminal=terminal,
    )
    estimate = solved.estimate
    for name in estimate.names:
        focal, sigma = estimate.intrinsics(name).focal_px[0], float(estimate.sigmas(name)[0])
        terminal.show(f"{name}: focal length {focal:.2f} ± {focal * sigma:.2g} px")
    terminal.show(f"Result: {out} ({REPORT_FILE}, {NETWORK_CLOUD_FILE}, {NETWORK_FILE})")
    conclude(verdict_on(solved), f"{out / REPORT_FILE} shows it.", terminal, args.output.require)
