"""Write the patterns as images, with a sequence.yaml that describes them, to be projected by any other means.

With --video they are a film as well, to be shown by any player and filmed by any camera.
"""

from pathlib import Path

from scanner.commands.options_of_rigs import PatternsCommand
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.patterns import SEQUENCE_FILE, Pattern, write_sequence
from scanner.quantities import parse_seconds
from scanner.recordings import CONTAINERS, Programme, programme_of, write_player_video
from scanner.results import OutputFolder
from scanner.ui import Terminal

_HOLD_S, _LOOPS = 0.2, 1


def run(args: PatternsCommand) -> None:
    """Do the work. Raises InputError."""
    config = args.settings.load()
    patterns = config.sequence.patterns(config.projector_size)
    programme = _programme(args, patterns, config)
    terminal = Terminal(quiet=args.quiet)
    with OutputFolder(args.out) as output:
        with terminal.step("Drawing the patterns"):
            more = {"video": programme.as_dict(str(args.video))} if programme else {}
            write_sequence(output.folder, patterns, config.projector_size, config.projector.grid, **more)
        if programme:
            with terminal.step("Writing the video"):
                write_player_video(output.folder / str(args.video), programme)
    width, height = config.projector.grid.device_size(config.projector_size)
    terminal.show(f"{len(patterns)} patterns of {width} × {height} pixels, and sequence.yaml, are in {args.out}")
    if programme:
        terminal.show(
            f"{args.video}, {programme.length_s:.0f} s, is there, too.",
            "→ Show it and film it, as docs/phone.md says; "
            f"scan import FILM --sequence {args.out / SEQUENCE_FILE} --out CAPTURE makes a capture of the film.",
        )
        return
    terminal.show(
        "→ Project each and photograph it. With a capture.yaml beside the photographs, which is sequence.yaml with the "
        "camera's size and their names, scan replay FOLDER reconstructs."
    )


def _programme(args: PatternsCommand, patterns: tuple[Pattern, ...], config: Config) -> Programme | None:
    if args.video is None:
        if args.hold is not None or args.loops is not None:
            raise InputError("--hold and --loops are for a video: give --video as well, as in --video sequence.mp4")
        return None
    if Path(args.video).name != args.video or Path(args.video).suffix.lower() not in CONTAINERS:
        raise InputError(
            f"--video {args.video}: expected a file name ending in {' or '.join(CONTAINERS)}; it is written into --out"
        )
    try:
        hold_s = _HOLD_S if args.hold is None else parse_seconds("--hold", args.hold)
        loops = _LOOPS if args.loops is None else args.loops
        return programme_of(patterns, config.projector_size, hold_s, loops, config.projector.grid)
    except ValueError as error:
        raise InputError(f"--hold, --loops: {error}") from error
