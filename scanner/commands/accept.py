"""Test the scanner with a calibrated ball bar."""

from pathlib import Path

from scanner.commands.options_of_results import AcceptCommand
from scanner.errors import InputError
from scanner.io import new_files, refuse_existing
from scanner.measuring import (
    ACCEPTANCE_FILE,
    ACCEPTANCE_PAGE,
    Acceptance,
    Error,
    acceptance_findings,
    errors_of,
    parse_ball_bar,
    read_scene,
    summary_table,
    write_acceptance,
    write_acceptance_page,
)
from scanner.results import path_beside, read_finished_scan
from scanner.ui import Terminal


def run(args: AcceptCommand) -> None:
    """Do the work. Raises InputError, NoMeasurementError."""
    terminal = Terminal(quiet=args.quiet)
    out = args.out or path_beside(args.results[0], "-accepted")
    for name in (ACCEPTANCE_FILE, ACCEPTANCE_PAGE):
        refuse_existing(out / name, overwrite=args.overwrite)
    acceptance = _accept(args.results, args.ball_bar, terminal)
    with new_files(out, (ACCEPTANCE_FILE, ACCEPTANCE_PAGE), overwrite=args.overwrite) as (document, page):
        write_acceptance(document, acceptance)
        write_acceptance_page(page, acceptance)
    terminal.show(*dict.fromkeys(acceptance.sentences), summary_table(acceptance))
    for finding in acceptance_findings(acceptance):
        terminal.show(f"Note: {finding}")
    terminal.show(
        f"Written: {out} ({ACCEPTANCE_PAGE}, {ACCEPTANCE_FILE})",
        f"→ Open {out / ACCEPTANCE_PAGE} in a browser: the errors of each place, to be printed.",
    )


def _accept(results: list[Path], ball_bar: str, terminal: Terminal) -> Acceptance:
    errors: list[Error] = []
    sentences, unit, bar = [], "", None
    for result in results:
        with terminal.step(f"Measuring {result}"):
            scan = read_finished_scan(result)
            if unit not in ("", scan.unit):
                raise InputError(
                    f"{result}: its unit is {scan.unit}, but that of {results[0]} is {unit}: give results of one unit"
                )
            unit = scan.unit
            bar = parse_ball_bar(ball_bar, unit)
            scene = read_scene(result, scan.calibration)
            errors += errors_of(str(result), scan, scene, bar)
            sentences.append(scene.sentence)
    if bar is None:
        raise InputError("expected at least one result")
    return Acceptance(unit, bar, tuple(errors), tuple(sentences))
