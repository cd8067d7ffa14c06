"""Put stations of one rig before a thing together to one surface; they exist already, or are captured first."""

from scanner.commands.options_of_scans import ObjectCommand
from scanner.commands.outcome import conclude
from scanner.objects import scan_object, verdict_on
from scanner.quantities import shown_unit
from scanner.ui import Terminal


def run(args: ObjectCommand) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError, GradeError."""
    terminal, config = Terminal(quiet=args.output.quiet), args.settings.load()
    out = args.output.place(args.settings.file.stem)
    solved, surface = scan_object(
        config,
        out,
        calibration=args.calibration,
        stations=args.stations,
        fill=args.fill,
        overwrite=args.output.overwrite,
        terminal=terminal,
    )
    unit = shown_unit(solved.unit)
    if surface is not None and surface.volume is not None:
        volume, sigma = (number * unit.factor**3 for number in surface.volume)
        terminal.show(f"Volume: {volume:.6g} ± {sigma:.2g} {unit.name}³")
    terminal.show(f"Result: {out} (report.html, object.ply, object.glb, object.yaml)")
    conclude(verdict_on(solved), f"scan view {out} shows it.", terminal, args.output.require)
