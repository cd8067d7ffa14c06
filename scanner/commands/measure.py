"""Measure in a result: balls, faces, distances."""

from argparse import Namespace

from scanner.errors import InputError
from scanner.io import new_files, refuse_existing
from scanner.measuring import (
    FIGURE_FILE,
    MEASURE_FILE,
    measure,
    read_scene,
    shares_table,
    tables,
    write_document,
    write_figure,
)
from scanner.quantities import parse_length
from scanner.results import path_beside, read_finished_scan
from scanner.ui import Terminal

_ASSUMED_ANGLES = (
    "Note: the calibration's prior on these angles (corner.squareness_deg) is in them. An independent test is a "
    "ball or a length that it did not use."
)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, NoMeasurementError."""
    terminal = Terminal(quiet=args.quiet)
    out = args.out or path_beside(args.result, "-measured")
    with terminal.step("Measuring"):
        scan = read_finished_scan(args.result)
        diameters = [parse_length(text, scan.unit) for text in args.sphere]
        scene = read_scene(args.result, scan.calibration)
        measured = measure(scan, scene, diameters, [(x1, y1, x2, y2) for x1, y1, x2, y2 in args.distance])
    if not (measured.pictured or measured.distances):
        raise InputError(
            f"{args.result}: its matches have no faces to measure; give a ball with --sphere 50.8mm, or a distance "
            "with --distance X1 Y1 X2 Y2"
        )
    for name in (MEASURE_FILE, FIGURE_FILE):
        refuse_existing(out / name, overwrite=args.overwrite)
    names = (MEASURE_FILE, FIGURE_FILE) if measured.pictured else (MEASURE_FILE,)
    with new_files(out, names, overwrite=args.overwrite) as (document, *figure):
        write_document(document, measured, str(args.result))
        for path in figure:
            write_figure(path, measured)
    if not measured.pictured:
        (out / FIGURE_FILE).unlink(missing_ok=True)  # of an earlier measurement
    terminal.show(measured.scene.sentence, *tables(measured))
    if args.shares:
        terminal.show(shares_table(measured))
    if measured.scene.angles:
        terminal.show(_ASSUMED_ANGLES)
    terminal.show(f"Written: {out} ({MEASURE_FILE}{f', {FIGURE_FILE}' if measured.pictured else ''})")
    if not args.shares:
        terminal.show("→ The same command with --shares --overwrite shows where each sigma comes from.")
    else:
        terminal.show(f"→ scan view {args.result} measures between points that are clicked on.")
