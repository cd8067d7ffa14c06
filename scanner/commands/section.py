"""Cut the surface of a result by planes: contours with their lengths."""

from calib.diagnostics import SystematicErrors
from scanner.cleaning import CleanedResult, read_cleaned
from scanner.commands.options_of_results import SectionCommand
from scanner.errors import InputError
from scanner.io import new_files, refuse_existing
from scanner.measuring import (
    SECTION_FILES,
    Contour,
    cut,
    read_scene,
    rig_errors,
    write_section_dxf,
    write_section_svg,
    write_section_table,
)
from scanner.quantities import UNKNOWN_UNIT, empty_table, shown_unit, unit_name
from scanner.results import CALIBRATION_FILE, path_beside, read_calibration_of, read_uncertainty
from scanner.ui import Terminal

_SHOWN = 20


def run(args: SectionCommand) -> None:
    """Do the work. Raises InputError, StorageError."""
    terminal = Terminal(quiet=args.quiet)
    out = args.out or path_beside(args.result, "-section")
    if not args.plane:
        raise InputError("--plane: expected one or more, as in --plane z=1.2m")
    for name in SECTION_FILES:
        refuse_existing(out / name, overwrite=args.overwrite)
    with terminal.step("Cutting"):
        result = read_cleaned(args.result, args.capture)
        contours = cut(result, args.plane, args.every, _errors(args, result))
    writers = (write_section_table, write_section_svg, write_section_dxf)
    with new_files(out, SECTION_FILES, overwrite=args.overwrite) as paths:
        for path, write in zip(paths, writers, strict=True):
            write(path, contours, result.unit)
    _show(contours, result.unit, terminal)
    terminal.show(f"Written: {out} ({', '.join(SECTION_FILES)})", "→ CAD programs read the DXF, browsers the SVG.")


def _errors(args: SectionCommand, result: CleanedResult) -> SystematicErrors | None:
    """Of the rig, as the result's measurements have them; None of a network."""
    if not result.whole.stations:
        return None
    if result.whole.is_joined:
        calibration = read_calibration_of(args.result)
        return rig_errors(calibration, read_uncertainty(args.result / CALIBRATION_FILE, calibration))
    newest = result.whole.stations[-1]
    return read_scene(args.result, newest.scan.calibration, newest.folder).errors


def _show(contours: tuple[Contour, ...], unit: str, terminal: Terminal) -> None:
    length_unit = shown_unit(unit)
    table = empty_table(f"Contours, {length_unit.name}", "plane", "length", "closed")
    longest = sorted(enumerate(contours, start=1), key=lambda pair: -pair[1].length)[:_SHOWN]
    for number, contour in longest:
        length = length_unit.measured(contour.length, contour.sigma)
        table.add_row(str(number), contour.plane.name, length, "yes" if contour.is_closed else "no")
    terminal.show(table)
    if len(contours) > _SHOWN:
        terminal.show(f"The longest {_SHOWN} of {len(contours):,}; the table in the folder has all.")
    if unit == UNKNOWN_UNIT:
        terminal.show(f"Note: no length is known, so lengths and offsets are in {unit_name(unit)}.")
    if all(contour.sigma is None for contour in contours):
        terminal.show("Note: the calibration states no covariance, so that the lengths have no sigma.")
