"""Put stations of one rig before a thing together to one surface."""

from argparse import Namespace
from pathlib import Path

from scanner.commands.outcome import conclusion
from scanner.configuration import load_config
from scanner.objects.contents import SolvedObject, Surface
from scanner.objects.jobs import scan_object
from scanner.objects.verdict import verdict_on
from scanner.quantities import shown_unit
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    terminal = Terminal(quiet=args.quiet)
    config = load_config(args.config, args.set)
    found = scan_object(
        config,
        args.out,
        calibration=args.calibration,
        stations=args.stations,
        fill=args.fill,
        overwrite=args.overwrite,
        terminal=terminal,
    )
    show_object(*found, args.out, terminal)


def show_object(solved: SolvedObject, surface: Surface | None, out: Path, terminal: Terminal) -> None:
    """Print the summary of a thing that was published at `out`, what matters most last."""
    unit = shown_unit(solved.unit)
    if surface is not None and surface.volume is not None:
        volume, sigma = (each * unit.factor**3 for each in surface.volume)
        terminal.show(f"Volume: {volume:.6g} ± {sigma:.2g} {unit.name}³")
    terminal.show(f"Result: {out} (report.html, object.ply, object.glb, object.yaml)")
    terminal.show(*conclusion(verdict_on(solved), f"scan view {out} shows it."))
