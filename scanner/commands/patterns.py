"""Write the patterns as images, with a sequence.yaml that describes them, to be projected by any other means."""

from argparse import Namespace

from scanner.configuration import load_config
from scanner.patterns import write_sequence
from scanner.results import OutputFolder
from scanner.ui import Terminal


def run(args: Namespace) -> None:
    """Do the work. Raises InputError."""
    config = load_config(args.config, args.set)
    patterns = config.sequence.patterns(config.projector_size)
    terminal = Terminal(quiet=args.quiet)
    with OutputFolder(args.out) as output, terminal.step("Drawing the patterns"):
        write_sequence(output.folder, patterns, config.projector_size)
    width, height = config.projector_size
    terminal.show(
        f"{len(patterns)} patterns of {width} × {height} pixels, and sequence.yaml, are in {args.out}",
        "→ Project each and photograph it. With a capture.yaml beside the photographs, which is sequence.yaml with the "
        "camera's size and their names, scan replay FOLDER reconstructs.",
    )
