"""Register clouds of any scanner with each other: poses with sigmas, and one cloud."""

from scanner.commands.options_of_results import RegisterCommand
from scanner.comparing import (
    REGISTER_FILE,
    REGISTERED_FILE,
    RegisteredClouds,
    register_clouds,
    registration_rows,
    registration_verdict,
    write_registered_cloud,
    write_registration,
)
from scanner.io import new_files, refuse_existing
from scanner.quantities import empty_table, shown_unit
from scanner.ui import EXIT_REFUSED, Terminal


def run(args: RegisterCommand) -> int:
    """Do the work; returns the exit code. Raises InputError."""
    terminal = Terminal(quiet=args.quiet)
    for name in (REGISTER_FILE, REGISTERED_FILE):
        refuse_existing(args.out / name, overwrite=args.overwrite)
    clouds = register_clouds(args.clouds, terminal.track)
    verdict = registration_verdict(clouds)
    refused = verdict.grade == "refused"
    _show(clouds, terminal)
    terminal.show(f"{verdict.sign} {verdict.headline}", *(f"  {reason}" for reason in verdict.reasons), *clouds.notes)
    names = [REGISTER_FILE] if refused else [REGISTER_FILE, REGISTERED_FILE]
    with new_files(args.out, names, overwrite=args.overwrite) as (document, *cloud):
        write_registration(document, clouds)
        for path in cloud:
            write_registered_cloud(path, clouds)
    terminal.show(f"Written: {args.out} ({', '.join(names)})")
    advice = "scan compare tells where two of them differ." if not verdict.advice else verdict.advice
    terminal.show(f"→ {advice}")
    return EXIT_REFUSED if refused else 0


def _show(clouds: RegisteredClouds, terminal: Terminal) -> None:
    unit = shown_unit(clouds.unit).name
    table = empty_table("Clouds", "points", "rotation, °", f"position, {unit}")
    for row in registration_rows(clouds):
        table.add_row(*row)
    terminal.show(table)
