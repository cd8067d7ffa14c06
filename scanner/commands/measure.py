"""Measure in a result: balls, faces, distances."""

from collections.abc import Sequence
from pathlib import Path

from scanner.commands.options_of_results import MeasureCommand
from scanner.errors import InputError
from scanner.io import new_files, refuse_existing
from scanner.measuring import (
    FIGURE_FILE,
    MEASURE_FILE,
    NetworkPoints,
    PixelPlace,
    PlacedPoints,
    measure,
    measure_pixels,
    read_scene,
    shares_table,
    tables,
    write_document,
    write_figure,
)
from scanner.quantities import parse_length
from scanner.results import NETWORK, kind_of, path_beside, read_finished_result
from scanner.shown_text import shown
from scanner.ui import Terminal

_ASSUMED_ANGLES = (
    "Note: the calibration's prior on these angles (corner.squareness_deg) is in them. An independent test is a "
    "ball or a length that it did not use."
)


def run(args: MeasureCommand) -> None:
    """Do the work. Raises InputError, NoMeasurementError."""
    terminal = Terminal(quiet=args.quiet)
    out = args.out or path_beside(args.result, "-measured")
    if kind_of(args.result) is NETWORK:
        _measure_network(args, out, terminal)
        return
    with terminal.step("Measuring"):
        result = read_finished_result(args.result, args.capture)
        count, newest = len(result.stations), result.stations[-1]
        scan = newest.scan
        diameters = [parse_length(text, scan.unit) for text in args.sphere]
        pairs = [(_pixel(x1, y1, count), _pixel(x2, y2, count)) for x1, y1, x2, y2 in args.distance]
        scene = read_scene(args.result, scan.calibration, newest.folder)
        measured = measure(scan, scene, diameters, PlacedPoints.of(result, scene.errors), pairs)
    if not (measured.pictured or measured.distances):
        of_scan = "1:X1 Y1 2:X2 Y2, of the pixels of stations 1 and 2" if count > 1 else "X1 Y1 X2 Y2"
        raise InputError(
            f"{args.result}: its matches have no faces to measure; give a ball with --sphere 50.8mm, or a distance "
            f"with --distance {of_scan}"
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
    if count > 1 and measured.pictured:
        terminal.show(f"Faces and balls are those of {newest.name} of {count}; --capture N measures in another.")
    if args.shares:
        terminal.show(shares_table(measured))
    if measured.scene.angles:
        terminal.show(_ASSUMED_ANGLES)
    terminal.show(f"Written: {out} ({MEASURE_FILE}{f', {FIGURE_FILE}' if measured.pictured else ''})")
    if not args.shares:
        terminal.show("→ The same command with --shares --overwrite shows where each sigma comes from.")
    else:
        terminal.show(f"→ scan view {args.result} measures between points that are clicked on.")


def _measure_network(args: MeasureCommand, out: Path, terminal: Terminal) -> None:
    """Distances between pixels of any pairs of a network. Raises InputError."""
    if args.sphere or args.capture is not None:
        raise InputError("--sphere and --capture are for rigs; a network measures --distance between its pairs' pixels")
    with terminal.step("Measuring"):
        points = NetworkPoints.read(args.result)
        names = [pair.name for pair in points.stations]
        if not args.distance:
            raise InputError(
                f"{args.result}: give a distance with --distance {names[0]}:X1 Y1 {names[-1]}:X2 Y2, of the camera's "
                f"pixels; there are {', '.join(names)}"
            )
        pairs = [(_pixel_of_pair(x1, y1, names), _pixel_of_pair(x2, y2, names)) for x1, y1, x2, y2 in args.distance]
        measured = measure_pixels(points, pairs)
    refuse_existing(out / MEASURE_FILE, overwrite=args.overwrite)
    with new_files(out, [MEASURE_FILE], overwrite=args.overwrite) as (document,):
        write_document(document, measured, str(args.result))
    terminal.show(*tables(measured))
    if args.shares:
        terminal.show(shares_table(measured))
    if points.network_errors is None:
        terminal.show("Note: this result states no covariance of its devices: make it again with scan network.")
    terminal.show(f"Written: {out} ({MEASURE_FILE})")


def _pixel_of_pair(x: str, y: str, names: Sequence[str]) -> PixelPlace:
    """The pair, by its name, and the pixel: 'left-stage:600' '500'. Raises InputError."""
    name, _, column = x.rpartition(":")
    try:
        return names.index(name), float(column), float(y)
    except ValueError as error:
        raise InputError(
            f"--distance: expected a pair and a pixel of its camera, as in {names[0]}:600 500, found {shown(x)} "
            f"{shown(y)}; there are {', '.join(names)}"
        ) from error


def _pixel(x: str, y: str, count: int) -> PixelPlace:
    """The scan, of `count`, and the pixel that a distance names: '600' '500' is of the newest, '2:600' '500' of the
    second. Raises InputError.
    """
    station, _, column = x.rpartition(":")
    try:
        number, at = int(station or count), (float(column), float(y))
    except ValueError as error:
        raise InputError(
            f"--distance: expected a pixel as two numbers, with the number of a capture or station before it if there "
            f"are several, as in 600 500 or 2:600 500, found {shown(x)} {shown(y)}"
        ) from error
    if not 1 <= number <= count:
        raise InputError(f"--distance: expected the number of a capture or station, 1 to {count}, found {number}")
    return (number - 1, *at)
