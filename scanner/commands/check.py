"""Check the rig before a scan, and write the findings into the configuration on request."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from scanner.checking import (
    CheckReport,
    CheckState,
    check_calibration,
    check_configured_rig,
    config_of,
    refuse_no_update,
    table_of,
    take_capture,
    update_calibration,
    write_check,
)
from scanner.commands.command import is_enough
from scanner.commands.options_of_rigs import CheckCommand
from scanner.comparing import table
from scanner.configuration import set_keys
from scanner.errors import GradeError, InputError
from scanner.results import refuse_occupied
from scanner.ui import EXIT_DIFFERENT, Terminal, keep_off_the_terminal

# Significant digits: cameras set whole microseconds, and averages are no more accurate.
_EXPOSURE_DIGITS, _LIGHT_DIGITS = 1, 5


def run(args: CheckCommand) -> int:
    """Do the work; returns the exit code. Raises InputError, DeviceError, RefusalError, GradeError."""
    if args.captures or args.calibration:
        return _check_calibration(args)
    if args.update:
        raise InputError("--update is of a check with --calibration FILE")
    if args.settings.config is None:
        raise InputError("scan check needs --config FILE, or captures and --calibration FILE")
    config = args.settings.load()
    terminal = Terminal(quiet=args.quiet)
    keep_off_the_terminal()
    config.principal_point(config.camera_size)
    if args.out:
        refuse_occupied(args.out)
    report = check_configured_rig(config, terminal, None, args.watch)
    terminal.show(table_of(report, sys.stdout.encoding))
    if args.out:
        write_check(args.out, report)
        terminal.show(f"Written: {args.out}")
    if args.write:
        terminal.show(_write(args.settings.config, report))
    if report.failure:
        raise report.failure
    poor = sum(row.state is CheckState.POOR for row in report.rows)
    if not is_enough("fair" if poor else "good", args.require):
        things = "1 thing" if poor == 1 else f"{poor} things"
        raise GradeError(f"{things} could be better, and --require {args.require} asks for none; the table names them")
    better = f"{poor} {'thing' if poor == 1 else 'things'} could be better; to scan anyway: " if poor else ""
    terminal.show(f"→ {better}scan --config {args.settings.config}")
    return 0


def _check_calibration(args: CheckCommand) -> int:
    """Judge a calibration by captures, or by one that is taken. Raises InputError, DeviceError."""
    if args.calibration is None or not (args.captures or args.settings.config):
        raise InputError(
            "a calibration is checked by captures, or by a rig that takes one: scan check CAPTURE… --calibration FILE, "
            "or scan check --config FILE --calibration FILE"
        )
    if args.write or args.watch:
        raise InputError("--write and --watch are of a check without --calibration")
    if args.update:
        refuse_no_update(args.calibration)
    terminal = Terminal(quiet=args.quiet)
    config = args.settings.load() if args.settings.config else config_of(args.calibration, args.settings.set)
    with TemporaryDirectory(prefix="scan-check-") as temporary:
        captures = args.captures or [take_capture(config, Path(temporary) / "capture", terminal)]
        check = check_calibration(args.calibration, captures, config, args.out, terminal)
        verdict = check.verdict
        if check.comparison is not None:
            terminal.show(table(check.comparison))
        terminal.show(f"{verdict.sign} {verdict.headline}", *(f"  {reason}" for reason in verdict.reasons))
        if args.out:
            terminal.show(f"Result: {args.out} (what the captures say)")
        if args.update:
            between = Path(temporary) / "update"
            between.mkdir()
            update = update_calibration(args.calibration, check, captures, config, between, terminal)
            lists = f"{update.log.name} lists both"
            terminal.show(f"Updated: {update.file}; the calibration before is {update.kept.name}, and {lists}")
            return 0
    if verdict.advice:
        terminal.show(f"→ {verdict.advice}")
    if verdict.grade == "refused":
        return EXIT_DIFFERENT
    if not is_enough(verdict.grade, args.require):
        raise GradeError(f"the calibration is {verdict.grade}, and --require {args.require} asks for better")
    return 0


def _write(path: Path, report: CheckReport) -> str:
    """Write the findings into the configuration file; returns a sentence about it. Raises InputError."""
    values: dict[str, object] = {}
    if report.exposure_us is not None:
        values["rig.exposure_us"] = round(report.exposure_us, _EXPOSURE_DIGITS)
    if report.response is not None:
        values["projector.response"] = [round(light, _LIGHT_DIGITS) for light in report.response]
    if not values:
        return f"{path} is unchanged: there is nothing to write"
    backup = set_keys(path, values)
    return f"{path}: {' and '.join(values)} set; the original file is {backup.name}"
