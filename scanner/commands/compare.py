"""Compare two calibrations of one rig: where in the picture they differ, and whether their sigmas allow it."""

from scanner.commands.options_of_results import CompareCommand
from scanner.comparing import (
    COMPARE_FILE,
    COMPARE_PAGE,
    compare_files,
    comparison_verdict,
    table,
    write_compare,
    write_compare_page,
)
from scanner.errors import InputError
from scanner.io import new_files, refuse_existing
from scanner.shown_text import shown
from scanner.ui import EXIT_DIFFERENT, Terminal


def run(args: CompareCommand) -> int:
    """Do the work; returns the exit code. Raises InputError."""
    terminal = Terminal(quiet=args.quiet)
    if args.out:
        for name in (COMPARE_FILE, COMPARE_PAGE):
            refuse_existing(args.out / name, overwrite=args.overwrite)
    depths = [depth for depth in (args.depths or "").split(",") if depth.strip()]
    if args.depths is not None and not depths:
        raise InputError(f"--depths: expected lengths, as in 1m,2m,3m, found {shown(args.depths)}")
    comparison = compare_files(args.first, args.second, depths)
    verdict = comparison_verdict(comparison)
    terminal.show(table(comparison), f"{verdict.sign} {verdict.headline}", *(f"  {each}" for each in verdict.reasons))
    if args.out:
        with new_files(args.out, (COMPARE_FILE, COMPARE_PAGE), overwrite=args.overwrite) as (document, page):
            write_compare(document, comparison)
            write_compare_page(page, comparison)
        terminal.show(
            f"Written: {args.out} ({COMPARE_PAGE}, {COMPARE_FILE})",
            f"→ Open {args.out / COMPARE_PAGE} in a browser: where in the picture they differ.",
        )
    else:
        terminal.show("→ The same command with --out DIR draws where in the picture they differ.")
    return EXIT_DIFFERENT if verdict.grade == "refused" and not args.allow else 0
