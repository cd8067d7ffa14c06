"""Calibrate several cameras and projectors together, from captures of their pairs."""

from argparse import Namespace

from scanner.commands.outcome import conclude
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.networks import KnownDistance, scan_network, verdict_on
from scanner.results import NETWORK_CLOUD_FILE, NETWORK_FILE, REPORT_FILE, default_out
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError, GradeError."""
    terminal = Terminal(quiet=args.quiet)
    out = args.out or default_out("network", overwrite=args.overwrite)
    known = KnownDistance.parse(args.distance) if args.distance else None
    config = load_config(args.config, args.set)
    if not args.captures and args.config is None:
        raise InputError("give captures of pairs, or --config FILE with the devices to take them")
    solved = scan_network(config, out, folders=args.captures, known=known, overwrite=args.overwrite, terminal=terminal)
    estimate = solved.estimate
    for name in estimate.names:
        focal, sigma = estimate.intrinsics(name).focal_px[0], float(estimate.sigmas(name)[0])
        terminal.show(f"{name}: focal length {focal:.2f} ± {focal * sigma:.2g} px")
    terminal.show(f"Result: {out} ({REPORT_FILE}, {NETWORK_CLOUD_FILE}, {NETWORK_FILE})")
    conclude(verdict_on(solved), f"{out / REPORT_FILE} shows it.", terminal, args.require)
