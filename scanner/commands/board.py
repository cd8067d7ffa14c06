"""Calibrate from captures of a printed board."""

from argparse import Namespace
from pathlib import Path

from scanner.boards import calibrate_captures, parse_target, read_folders, save_result, summary
from scanner.boards.target import UNIT
from scanner.boards.verdict import verdict_on
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.quantities import calibration_table, parse_length
from scanner.results import default_out, new_result, refuse_occupied
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    terminal = Terminal(quiet=args.quiet)
    if not args.captures or args.board is None or args.square is None:
        raise InputError(
            "expected captures, and which board it is: scan board CAPTURE… --board chessboard:9x7 --square 10mm"
        )
    target = parse_target(args.board, parse_length(args.square, UNIT))
    out: Path = args.out or default_out("board", overwrite=args.overwrite)
    if not args.overwrite:
        refuse_occupied(out)
    result = calibrate_captures(read_folders(args.captures), target, terminal)
    with new_result(out, Config(), overwrite=args.overwrite) as folder:
        save_result(result, folder)
    verdict = verdict_on(result)
    terminal.show(verdict.headline + ".", *verdict.reasons, verdict.advice)
    terminal.show(calibration_table(result.found.calibration), summary(result))
    for note in result.notes:
        terminal.show(f"Note: {note}")
    terminal.show(f"Written: {out} (calibration.yaml, report.html)")
