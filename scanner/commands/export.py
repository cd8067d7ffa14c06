"""Write a result in another program's format and conventions."""

import math

from scanner.commands.options_of_results import ExportCommand
from scanner.errors import InputError
from scanner.exporting import DEFAULT_GAMMA, DEFAULT_POINTS, FORMATS, ExportRequest
from scanner.results import path_beside
from scanner.ui import Terminal

_LEAST_GAMMA, _MOST_GAMMA = 0.1, 10.0


def run(args: ExportCommand) -> None:
    """Do the work. Raises InputError."""
    target = FORMATS[args.to]
    if args.points is not None and args.to != "colmap":
        raise InputError(f"--points is for colmap; {args.to} takes all points")
    if args.points is not None and args.points < 1:
        raise InputError(f"--points: expected at least 1, found {args.points}")
    if args.to != "mapping" and not (args.eye is None and args.gamma is None):
        raise InputError(f"--eye and --gamma are for mapping; {args.to} has no content and no blend maps")
    gamma = DEFAULT_GAMMA if args.gamma is None else args.gamma
    if not _LEAST_GAMMA <= gamma <= _MOST_GAMMA:
        raise InputError(f"--gamma: expected {_LEAST_GAMMA} to {_MOST_GAMMA}, found {gamma}")
    eye = None if args.eye is None else _place(args.eye)
    out = args.out or path_beside(args.result, target.ending)
    target.check_name(out)
    terminal = Terminal(quiet=args.quiet)
    with terminal.step("Exporting"):
        written = target.write(
            ExportRequest(args.result, out, args.overwrite, args.capture, args.points or DEFAULT_POINTS, eye, gamma)
        )
    terminal.show(*written, f"Written: {out}", f"→ {target.opened_by}")


def _place(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(math.isfinite(part) for part in (x, y, z)):
        raise InputError(f"--eye: expected three numbers, as in --eye=0.5,0.2,-1, found '{text}'")
    return x, y, z
