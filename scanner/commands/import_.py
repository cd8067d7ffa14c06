"""Make a capture folder of frames that another program took: their order is recognised, and checked by decoding."""

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.table import Table

from scanner.commands import options
from scanner.errors import InputError
from scanner.importing import (
    LAYOUTS,
    FrameFiles,
    Given,
    Layout,
    Recognised,
    Rejected,
    find_frames,
    recognise,
    take_samples,
    write_capture,
)
from scanner.results import OutputFolder
from scanner.ui import Terminal

_NAMED = {layout.name: layout for layout in LAYOUTS}


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder with the frames")
    parser.add_argument(
        "--from", dest="layout", metavar="FORMAT", help=f"whose order it is, one of {', '.join(_NAMED)} (default: all)"
    )
    parser.add_argument("--projector", type=_size, metavar="WxH", help="the projector's size, as in 1024x768")
    parser.add_argument("--cell", type=_cell, metavar="PX", help="projector pixels to a cell of the Gray code")
    parser.add_argument("--frames", metavar="GLOB", help="take only files of such a name, as in 'cam1_*.png'")
    parser.add_argument("--out", type=Path, metavar="CAPTURE", help="folder to make (default: only say what it is)")
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError."""
    layouts = LAYOUTS if args.layout is None else (_layout(args.layout),)
    terminal = Terminal(quiet=args.quiet)
    output = OutputFolder(args.out) if args.out else None
    files = find_frames(args.folder, args.frames)
    with terminal.step("Looking at the frames"):
        samples = take_samples([*files.numbered, *(path for path in (files.white, files.black) if path)])
    given = Given(args.projector, args.cell)
    found, rejected = recognise(files, layouts, given, samples, terminal)
    chosen = _only_one(files, found, rejected)
    if args.layout is None:
        terminal.show(_table(chosen, found, rejected))
    left_out = f"; left out: {', '.join(path.name for path in files.left_out)}" if files.left_out else ""
    terminal.show(f"{files}: {chosen.layout.title}, {_shown(chosen.projector_size)} ({chosen.how}){left_out}")
    if output is None:
        return
    with output:
        write_capture(output.folder, chosen, samples.camera_size)
    terminal.show(f"{len(chosen.files)} frames and capture.yaml are in {args.out}")


def _layout(name: str) -> Layout:
    if name not in _NAMED:
        raise InputError(f"--from {name}: expected one of {', '.join(_NAMED)}")
    return _NAMED[name]


def _only_one(files: FrameFiles, found: Sequence[Recognised], rejected: Sequence[Rejected]) -> Recognised:
    """What fits; layouts that mean the same are one. Raises InputError if none fits, or several that differ."""
    if not found:
        told = [each for each in rejected if each.lacking] or rejected
        reasons = "".join(f"\n  {each.layout.name}: {each.why}" for each in told)
        raise InputError(f"{files.folder}: {files}; in no order that is known they are a capture:{reasons}")
    likely = [each for each in found if each.likely == max(other.likely for other in found)]
    if len({(each.patterns, each.projector_size) for each in likely}) > 1:
        names = "".join(f"\n  {each.layout.name}: {_shown(each.projector_size)}, {each.how}" for each in likely)
        raise InputError(f"{files.folder}: {files}; several orders fit, say which with --from or --projector:{names}")
    return likely[0]


def _shown(size: tuple[int, int]) -> str:
    return f"projector {size[0]} × {size[1]}"


def _table(chosen: Recognised, found: Sequence[Recognised], rejected: Sequence[Rejected]) -> Table:
    """A line for each layout: whether it fits, and why, or why not."""
    table = Table(box=box.SIMPLE, pad_edge=False)
    for heading in ("format", "fits", ""):
        table.add_column(heading, no_wrap=heading != "")
    whys = {each.layout.name: ("no", each.why) for each in rejected}
    for each in found:
        same = (each.patterns, each.projector_size) == (chosen.patterns, chosen.projector_size)
        whys[each.layout.name] = ("yes" if same else "less", f"{_shown(each.projector_size)}, {each.how}")
    for layout in LAYOUTS:
        if layout.name in whys:
            table.add_row(layout.name, *whys[layout.name])
    return table


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().replace("×", "x").partition("x")
    if not (width.isdecimal() and height.isdecimal() and 2 <= int(width) <= 65535 and 2 <= int(height) <= 65535):
        raise ArgumentTypeError(f"expected a size like 1024x768, found '{text}'")
    return int(width), int(height)


def _cell(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= 4096):
        raise ArgumentTypeError(f"expected a number of pixels from 1 on, found '{text}'")
    return int(text)
