"""Calibrate from a printed board: from captures of it, or live; or print one."""

from pathlib import Path

from scanner.boards import (
    FromBoards,
    Target,
    calibrate_captures,
    capture_boards,
    check_live,
    parse_target,
    printed_target,
    read_folders,
    save_result,
    summary,
    verdict_on,
    write_pdf,
)
from scanner.commands.options_of_scans import BoardCommand
from scanner.commands.outcome import conclude
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.io import new_file
from scanner.quantities import calibration_table, parse_length
from scanner.results import CALIBRATION_FILE, REPORT_FILE, new_result, refuse_occupied
from scanner.targets import UNIT
from scanner.ui import Terminal

_EXAMPLE = "as in: scan board CAPTURE… --board chessboard:9x7 --square 10mm"


def run(args: BoardCommand) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError, GradeError."""
    terminal = Terminal(quiet=args.output.quiet)
    if args.sheet:
        _print(args.sheet, args, terminal)
        return
    if bool(args.captures) == bool(args.settings.config):
        raise InputError(f"expected captures of a board, or --config FILE to take some, {_EXAMPLE}")
    if args.board is None or args.square is None:
        raise InputError(f"expected --board and --square, the board and the size of its squares, {_EXAMPLE}")
    target = parse_target(args.board, parse_length(args.square, UNIT))
    out: Path = args.output.place("board")
    result = _live(args, target, out, terminal) if args.settings.config else _from_captures(args, target, out, terminal)
    terminal.show(calibration_table(result.calibrated.calibration), summary(result))
    for finding in result.findings:
        terminal.show(f"Note: {finding}")
    terminal.show(f"Result: {out} ({REPORT_FILE}, {CALIBRATION_FILE})")
    use = f"scan replay CAPTURE --calibration {out / CALIBRATION_FILE} reconstructs with it."
    conclude(verdict_on(result), use, terminal, args.output.require)


def _print(wanted: str, args: BoardCommand, terminal: Terminal) -> None:
    square = parse_length(args.square, UNIT) if args.square else None
    target, sheet = printed_target(wanted, square)
    out: Path = args.output.out or Path(f"{target.kind}-{target.columns}x{target.rows}-{sheet}.pdf")
    with new_file(out, overwrite=args.output.overwrite) as path:
        write_pdf(path, target, sheet)
    terminal.show(
        f"Written: {out}",
        "→ Print it at 100 %, measure the ruler, glue it to something flat and firm, and calibrate with "
        f"--board {target} --square {target.square:g}mm.",
    )


def _from_captures(args: BoardCommand, target: Target, out: Path, terminal: Terminal) -> FromBoards:
    if not args.output.overwrite:
        refuse_occupied(out, overwrite=False)
    config = load_config(None, args.settings.set)
    result = calibrate_captures(read_folders(args.captures, config.projector.grid), target, terminal, config)
    with new_result(out, config, overwrite=args.output.overwrite) as folder:
        save_result(result, folder)
    return result


def _live(args: BoardCommand, target: Target, out: Path, terminal: Terminal) -> FromBoards:
    config = args.settings.load()
    check_live(config, args.number, target, terminal)
    with new_result(out, config, overwrite=args.output.overwrite, keep_capture=True) as folder:
        result = capture_boards(config, args.number, target, folder, terminal)
        save_result(result, folder)
    return result
