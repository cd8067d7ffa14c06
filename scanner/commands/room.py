"""Put stations of one rig together to a whole room; they exist already, or are captured first."""

from scanner.commands.options_of_scans import RoomCommand
from scanner.commands.outcome import conclude
from scanner.quantities import calibration_table, shown_unit
from scanner.rooms import scan_room, verdict_on
from scanner.ui import Terminal


def run(args: RoomCommand) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError, GradeError."""
    terminal, config = Terminal(quiet=args.output.quiet), args.settings.load()
    out = args.output.place(args.settings.file.stem)
    solved = scan_room(
        config,
        out,
        stations=args.stations,
        calibration=args.calibration,
        overwrite=args.output.overwrite,
        terminal=terminal,
    )
    truth = solved.stations[0].decoded.metadata.truth
    terminal.show(calibration_table(solved.calibration, truth))
    unit = shown_unit(solved.unit)
    for station in solved.stations[1:]:
        sigma = float(sum(station.sigma**2) ** 0.5)
        terminal.show(f"{station.name}: {len(station.decoded.matches):,} matches, its position ± {unit.error(sigma)}")
    terminal.show(f"Result: {out} (report.html, room.ply, room.glb, floorplan.svg, floorplan.dxf, room.yaml)")
    conclude(verdict_on(solved), f"scan view {out} shows it.", terminal, args.output.require)
