"""Write a result in another program's format and conventions."""

from argparse import Namespace

from scanner.errors import InputError
from scanner.exporting import DEFAULT_POINTS, FORMATS, Request
from scanner.results import beside
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError."""
    target = FORMATS[args.to]
    if args.points is not None and args.to != "colmap":
        raise InputError(f"--points is for colmap; {args.to} takes all there are")
    if args.points is not None and args.points < 1:
        raise InputError(f"--points: expected at least 1, found {args.points}")
    out = args.out or beside(args.result, target.ending)
    target.check_name(out)
    terminal = Terminal(quiet=args.quiet)
    with terminal.step("Exporting"):
        written = target.write(Request(args.result, out, args.overwrite, args.points or DEFAULT_POINTS))
    terminal.show(*written, f"Written: {out}", f"→ {target.opened_by}")
