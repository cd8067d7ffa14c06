"""Put stations of one rig before a thing together to one surface; they exist already, or are captured first."""

from argparse import Namespace

from scanner.commands.outcome import conclude
from scanner.configuration import load_config
from scanner.objects import scan_object, verdict_on
from scanner.quantities import shown_unit
from scanner.results import default_out
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError, GradeError."""
    terminal, config = Terminal(quiet=args.quiet), load_config(args.config, args.set)
    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    solved, surface = scan_object(
        config,
        out,
        calibration=args.calibration,
        stations=args.stations,
        fill=args.fill,
        overwrite=args.overwrite,
        terminal=terminal,
    )
    unit = shown_unit(solved.unit)
    if surface is not None and surface.volume is not None:
        volume, sigma = (number * unit.factor**3 for number in surface.volume)
        terminal.show(f"Volume: {volume:.6g} ± {sigma:.2g} {unit.name}³")
    terminal.show(f"Result: {out} (report.html, object.ply, object.glb, object.yaml)")
    conclude(verdict_on(solved), f"scan view {out} shows it.", terminal, args.require)
