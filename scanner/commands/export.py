"""Write a result in another program's format and conventions."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from scanner.commands import options
from scanner.commands.options import default_path
from scanner.errors import InputError
from scanner.exporting import DEFAULT_POINTS, FORMATS, Request
from scanner.ui import Terminal


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder that a scan left")
    formats = "; ".join(f"{name}: {target.about}" for name, target in FORMATS.items())
    parser.add_argument("--to", required=True, choices=list(FORMATS), metavar="FORMAT", help=formats)
    parser.add_argument(
        "--out", type=Path, metavar="PATH", help="file to write, a folder for colmap (default: beside the result)"
    )
    parser.add_argument(
        "--points", type=int, metavar="N", help=f"colmap: at most so many points (default: {DEFAULT_POINTS:,})"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier file of that name")
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError."""
    target = FORMATS[args.to]
    if args.points is not None and args.to != "colmap":
        raise InputError(f"--points is for colmap; {args.to} takes all there are")
    if args.points is not None and args.points < 1:
        raise InputError(f"--points: expected at least 1, found {args.points}")
    out = args.out or default_path(args.result, target.ending)
    target.check_name(out)
    terminal = Terminal(quiet=args.quiet)
    with terminal.step("Exporting"):
        told = target.write(Request(args.result, out, args.overwrite, args.points or DEFAULT_POINTS))
    terminal.show(*told, f"Written: {out}")
