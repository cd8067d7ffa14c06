"""Put stations of one rig together to a whole room; they exist already, or are captured first."""

from argparse import Namespace

from scanner.commands.outcome import conclude
from scanner.configuration import load_config
from scanner.quantities import calibration_table, shown_unit
from scanner.results import default_out
from scanner.rooms import scan_room, verdict_on
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError, GradeError."""
    terminal, config = Terminal(quiet=args.quiet), load_config(args.config, args.set)
    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    solved = scan_room(
        config,
        out,
        stations=args.stations,
        calibration=args.calibration,
        overwrite=args.overwrite,
        terminal=terminal,
    )
    truth = solved.stations[0].decoded.metadata.truth
    terminal.show(calibration_table(solved.calibration, truth))
    unit = shown_unit(solved.unit)
    for station in solved.stations[1:]:
        sigma = float(sum(station.sigma**2) ** 0.5)
        terminal.show(f"{station.name}: {len(station.decoded.matches):,} matches, its position ± {unit.error(sigma)}")
    terminal.show(f"Result: {out} (report.html, room.ply, room.glb, floorplan.svg, floorplan.dxf, room.yaml)")
    conclude(verdict_on(solved), f"scan view {out} shows it.", terminal, args.require)
