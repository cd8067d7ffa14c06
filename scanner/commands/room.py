"""Put stations of one rig together to a whole room."""

from argparse import Namespace
from pathlib import Path

from scanner.commands.outcome import conclusion
from scanner.configuration import load_config
from scanner.quantities import calibration_table, shown_unit
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.jobs import scan_room
from scanner.rooms.verdict import verdict_on
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    terminal = Terminal(quiet=args.quiet)
    config = load_config(args.config, args.set)
    solved = scan_room(
        config,
        args.out,
        stations=args.stations,
        calibration=args.calibration,
        overwrite=args.overwrite,
        terminal=terminal,
    )
    show_room(solved, args.out, terminal)


def show_room(solved: SolvedRoom, out: Path, terminal: Terminal) -> None:
    """Print the summary of a room that was published at `out`, what matters most last."""
    truth = solved.stations[0].decoded.metadata.truth
    terminal.show(calibration_table(solved.calibration, truth))
    unit = shown_unit(solved.unit)
    for station in solved.stations[1:]:
        sigma = float(sum(station.sigma**2) ** 0.5)
        terminal.show(f"{station.name}: {len(station.decoded.matches):,} matches, its position ± {unit.error(sigma)}")
    terminal.show(f"Result: {out} (report.html, room.ply, room.glb, floorplan.svg, floorplan.dxf, room.yaml)")
    terminal.show(*conclusion(verdict_on(solved), f"scan view {out} shows it."))
