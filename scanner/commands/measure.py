"""Measure in a result: how round a ball and how flat the faces came out, and how far two points are apart.

The faces are always measured. --sphere finds a ball of known diameter anywhere in the cloud; given twice, it finds two,
and the distance of their centres is told, too.
"""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from scanner.commands import options
from scanner.commands.options import default_path
from scanner.errors import InputError
from scanner.io import new_file, refuse_existing
from scanner.measuring import FIGURE_FILE, MEASURE_FILE, measure, tables, write_document, write_figure
from scanner.quantities import parse_length
from scanner.results import read_finished_scan
from scanner.ui import Terminal

_ASSUMED_ANGLES = (
    "Note: what the calibration took for granted about these angles (corner.squareness_deg) is in them; a ball or a "
    "length that it knew nothing of is the independent test."
)


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder that a scan left")
    parser.add_argument(
        "--sphere",
        action="append",
        default=[],
        metavar="DIAMETER",
        help="find and fit a ball, as in 50.8mm; without a unit, in the result's",
    )
    parser.add_argument(
        "--distance",
        nargs=4,
        type=float,
        action="append",
        default=[],
        metavar=("X1", "Y1", "X2", "Y2"),
        help="between the points at two camera pixels",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for measure.json and measure.png (default: beside the result)"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier measurement there")
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, NoMeasurementError."""
    terminal = Terminal(quiet=args.quiet)
    out = args.out or default_path(args.result, "-measured")
    with terminal.step("Measuring"):
        scan = read_finished_scan(args.result)
        diameters = [parse_length(text, scan.unit) for text in args.sphere]
        measured = measure(scan, diameters, [(x1, y1, x2, y2) for x1, y1, x2, y2 in args.distance])
    if measured.empty:
        raise InputError(
            f"{args.result}: its matches have no faces, so there is nothing to measure unless you say what: a ball "
            "with --sphere 50.8mm, or a distance with --distance X1 Y1 X2 Y2"
        )
    for name in (MEASURE_FILE, FIGURE_FILE):
        refuse_existing(out / name, overwrite=args.overwrite)
    with new_file(out / MEASURE_FILE, overwrite=args.overwrite) as path:
        write_document(path, measured, str(args.result))
    if measured.pictured:
        with new_file(out / FIGURE_FILE, overwrite=args.overwrite) as path:
            write_figure(path, measured)
    else:
        (out / FIGURE_FILE).unlink(missing_ok=True)  # an earlier measurement's
    terminal.show(*tables(measured))
    if measured.angles:
        terminal.show(_ASSUMED_ANGLES)
    terminal.show(f"Written: {out} ({MEASURE_FILE}{f', {FIGURE_FILE}' if measured.pictured else ''})")
