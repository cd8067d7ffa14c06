"""Make a capture folder of a film of the sequence's video."""

from scanner.commands.options_of_rigs import ImportCommand
from scanner.errors import InputError
from scanner.recordings import exposure_text, import_recording, read_programme
from scanner.results import OutputFolder
from scanner.ui import Terminal

_OF_FRAMES = ("projector", "cell", "periods", "frames", "order", "flip", "pixel_aspect")


def given_of_frames(args: ImportCommand) -> list[str]:
    """The given args that say what frames of unknown order show."""
    given = ["--from"] if args.format is not None else []
    return given + [f"--{name.replace('_', '-')}" for name in _OF_FRAMES if getattr(args, name) is not None]


def run(args: ImportCommand) -> None:
    """Do the work. Raises InputError."""
    given = given_of_frames(args)
    if given:
        raise InputError(f"{', '.join(given)}: only for a folder of frames, not for a recording")
    if args.sequence is None:
        raise InputError(f"{args.folder}: is a file: a recording needs --sequence, the sequence.yaml of its video")
    if args.out is None:
        raise InputError(f"{args.folder}: a recording needs --out, the folder to make")
    terminal = Terminal(quiet=args.quiet)
    programme = read_programme(args.sequence)
    with OutputFolder(args.out) as output:
        imported = import_recording(args.folder, programme, output.folder, terminal)
    clocks, loops = imported.clocks, len(imported.clocks.loops)
    terminal.show(
        f"{len(programme.patterns)} pictures of {imported.frames_per_picture:.1f} frames each, and capture.yaml, "
        f"are in {args.out}; exposure {exposure_text(clocks)}, {loops} loop{'s' * (loops > 1)}",
        *map(str, imported.findings),
        f"→ scan replay {args.out} reconstructs it.",
    )
