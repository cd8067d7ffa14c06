"""Make a capture folder of frames that another program took: their order is recognised, and checked by decoding."""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from rich import box
from rich.markup import escape
from rich.table import Table

from calib.geometry import SQUARE_PIXELS, PixelGrid
from scanner.capture import CAPTURE_FILE, capture_above, open_capture
from scanner.commands import import_recording
from scanner.commands.options_of_rigs import ImportCommand
from scanner.decoding import describe_copies
from scanner.errors import InputError
from scanner.importing import (
    DIAMOND_ARRAYS,
    LAYOUTS,
    FrameFiles,
    FrameLayout,
    Given,
    LevelSamples,
    OrderStage,
    Recognised,
    Rejected,
    describe_order,
    find_frames,
    fringe_layouts,
    recognise,
    take_samples,
    write_capture,
)
from scanner.patterns import in_square_pixels
from scanner.results import OutputFolder
from scanner.shown_text import harmless
from scanner.ui import Terminal

_MOST_CELL_PX, _MOST_ORDERS = 4096, 99
_RATIOS = 0.2, 5.0  # of the sides of pixels
_MOST_PERIODS, _MOST_TO_A_PICTURE = 8, 1000


def run(args: ImportCommand) -> None:
    """Do the work. Raises InputError."""
    if args.sequence is not None or args.folder.is_file():
        import_recording.run(args)
        return
    if (above := capture_above(args.folder)) is not None:
        _copy_own(above, args)
        return
    cell = _number(args.cell, "--cell", "a number of pixels", _MOST_CELL_PX)
    given = Given(_size(args.projector), cell, periods=_periods(args.periods))
    every = (*LAYOUTS, *fringe_layouts(given.periods))
    name = args.format
    layouts = every if name is None else (_named(every, name),)
    terminal = Terminal(quiet=args.quiet)
    output = OutputFolder(args.out) if args.out else None
    files = find_frames(args.folder, args.frames)

    @cache
    def look() -> LevelSamples:
        with terminal.step("Looking at the frames"):
            return take_samples([*files.numbered, *(path for path in (files.white, files.black) if path)], args.flip)

    recognised, rejected = recognise(files, layouts, given, look, terminal, args.flip)
    order = _number(args.order, "--order", "a number of the list", _MOST_ORDERS)
    is_looked_at = recognised or any(reason.stage > OrderStage.COUNT for reason in rejected)
    grid = None if args.pixel_aspect is None else PixelGrid(_ratio(args.pixel_aspect))
    copies = _copies(files, look()) if is_looked_at else ""
    chosen = _only_one(files, recognised, rejected, order, copies)
    if name is None:
        terminal.show(_table(every, chosen, recognised, rejected))
    unused = [*files.left_out, *(path for path in files.numbered if path not in chosen.files)]
    left_out = f"; left out: {', '.join(path.name for path in unused)}" if unused else ""
    terminal.show(f"{files}: {chosen.layout.title}, {_shown(chosen.projector_size)} ({chosen.how}){left_out}{copies}")
    if grid is None and chosen.projector_size in DIAMOND_ARRAYS:
        width, height = chosen.projector_size
        terminal.show(
            f"{width} × {height} mirrors are a diamond array (DLP LightCrafter), whose pixels are twice as wide as "
            "high: give --pixel-aspect 0.5, unless the picture was scaled to them."
        )
    if grid is not None:
        patterns, size = in_square_pixels(chosen.patterns, chosen.projector_size, grid)
        chosen = replace(chosen, patterns=patterns, projector_size=size)
        terminal.show(f"In square pixels: {_shown(size)}.")
    if output is None:
        terminal.show("→ The same command with --out CAPTURE makes a capture of them.")
        return
    with output:
        write_capture(output.folder, chosen, look().camera_size, args.flip, grid or SQUARE_PIXELS)
    terminal.show(
        f"{len(chosen.files)} frames and capture.yaml are in {args.out}",
        f"→ scan replay {args.out} reconstructs it.",
    )


def _copy_own(capture: Path, args: ImportCommand) -> None:
    """Frames of a capture of this program's, whose `capture.yaml` says what they show."""
    given = import_recording.given_of_frames(args)
    listing = capture / CAPTURE_FILE
    if given:
        raise InputError(f"{listing} says what the frames show: leave out {', '.join(given)}")
    recording = open_capture(capture)
    terminal = Terminal(quiet=args.quiet)
    projector = _shown(recording.projector_size)
    terminal.show(f"{len(recording.files)} frames are listed in {listing}: {projector}", *map(str, recording.findings))
    if args.out is not None:
        with OutputFolder(args.out) as output:
            recording.copy_to(output.folder)
    terminal.show(f"→ scan replay {args.out or capture} reconstructs them.")


def _ratio(text: str) -> float:
    """A ratio from the command line. Raises InputError."""
    low, high = _RATIOS
    value = float(text) if re.fullmatch(r"[0-9]+\.?[0-9]*", text) else 0.0
    if not low <= value <= high:
        raise InputError(f"--pixel-aspect {text}: expected height over width, {low:g} to {high:g}, as in 0.5")
    return value


def _named(every: Sequence[FrameLayout], name: str) -> FrameLayout:
    names = {layout.name: layout for layout in every}
    if name not in names:
        raise InputError(f"--from {name}: expected one of {', '.join(names)}")
    return names[name]


def _only_one(
    files: FrameFiles, recognised: Sequence[Recognised], rejected: Sequence[Rejected], order: int | None, copies: str
) -> Recognised:
    """What fits, or of several orders the one of a number; layouts that mean the same are one. `copies`: said if none
    fits.

    Raises InputError if none fits, or several that differ, or not as many.
    """
    if not recognised:
        raise InputError(f"{files.folder}: {files}{copies}; they fit no known order of frames:{_reasons(rejected)}")
    likely = max((len(choice.files), choice.likely) for choice in recognised)
    choices = [choice for choice in recognised if (len(choice.files), choice.likely) == likely]
    differ = [*{(choice.patterns, choice.projector_size): choice for choice in choices[::-1]}.values()][::-1]
    if order is None and len(differ) == 1:
        return differ[0]
    if order is not None and order <= len(differ):
        return differ[order - 1]
    fit = f"{len(differ)} orders fit" if len(differ) > 1 else "one order fits"
    names = "".join(
        f"\n  {number}. {choice.layout.name}: {_shown(choice.projector_size)}; {describe_order(choice.patterns)} "
        f"({choice.how})"
        for number, choice in enumerate(differ, 1)
    )
    raise InputError(
        f"{files.folder}: {files}; {fit}, choose one with --order and its number, --from or --projector:{names}"
    )


def _copies(files: FrameFiles, samples: LevelSamples) -> str:
    """The frames that are the ones before them, and why, for a message."""
    names = [path.name for number, path in enumerate(files.numbered) if number in samples.copies]
    return f"; {describe_copies(', '.join(names), len(names))}" if names else ""


def _reasons(rejected: Sequence[Rejected]) -> str:
    """A line for each reason, the closest layouts first: only those that may fit, if there are any."""
    closest = [reason for reason in rejected if reason.stage >= OrderStage.DECODING] or rejected
    names: dict[str, list[str]] = defaultdict(list)
    for reason in closest:
        names[reason.why].append(reason.layout.name)
    return "".join(f"\n  {', '.join(of_reason)}: {why}" for why, of_reason in names.items())


def _shown(size: tuple[int, int]) -> str:
    return f"projector {size[0]} × {size[1]}"


def _table(
    every: Sequence[FrameLayout], chosen: Recognised, recognised: Sequence[Recognised], rejected: Sequence[Rejected]
) -> Table:
    """A line for each layout: whether it fits, and why, or why not."""
    table = Table(box=box.SIMPLE, pad_edge=False)
    for heading in ("format", "fits", ""):
        table.add_column(heading, no_wrap=heading != "")
    lines = {reason.layout.name: ("no", reason.why) for reason in rejected}
    for choice in recognised:
        same = (choice.patterns, choice.projector_size) == (chosen.patterns, chosen.projector_size)
        if same or lines.get(choice.layout.name, ("no",))[0] == "no":
            lines[choice.layout.name] = ("yes" if same else "less", f"{_shown(choice.projector_size)}, {choice.how}")
    for layout in every:
        if layout.name in lines:
            table.add_row(layout.name, *(escape(harmless(words)) for words in lines[layout.name]))
    return table


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, _, height = text.lower().replace("×", "x").partition("x")
    if not all(side.isdecimal() and 2 <= int(side) <= 65535 for side in (width, height)):
        raise InputError(f"--projector {text}: expected a size like 1024x768")
    return int(width), int(height)


def _number(text: str | None, option: str, what: str, most: int) -> int | None:
    if text is None:
        return None
    if not (text.isdecimal() and 1 <= int(text) <= most):
        raise InputError(f"{option} {text}: expected {what} from 1 to {most}")
    return int(text)


def _periods(text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    words = text.split(",")
    if len(words) > _MOST_PERIODS or not all(re.fullmatch(r"\d{1,4}(\.\d{1,6})?", word) for word in words):
        raise InputError(
            f"--periods {text}: expected at most {_MOST_PERIODS} numbers of fringe periods across the picture, in the "
            "order of the frames, as in 59,64,70"
        )
    counts = tuple(map(float, words))
    if not 1 <= min(counts) <= max(counts) <= _MOST_TO_A_PICTURE or len({*counts}) < len(counts):
        raise InputError(f"--periods {text}: expected different numbers from 1 to {_MOST_TO_A_PICTURE}")
    return counts
