"""Scan with the configured rig: capture, calibrate, reconstruct."""

from argparse import ArgumentParser, Namespace

from scanner import pipeline
from scanner.commands import options
from scanner.commands.outcome import show_outcome
from scanner.config import load_config
from scanner.masks import read_masks
from scanner.result import default_out, new_result
from scanner.terminal import Terminal


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    options.add_config(parser, required=True)
    options.add_out(parser, default="scans/<name of the configuration>")
    options.add_overwrite(parser)
    options.add_masks(parser)
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError."""
    config = load_config(args.config, args.set)
    terminal = Terminal(quiet=args.quiet)
    # Whatever could be refused after the capture is asked before it.
    config.principal_point(config.camera_size)
    masks = read_masks(args.masks, config.camera_size) if args.masks else None
    out = args.out or default_out(args.config.stem, overwrite=args.overwrite)
    with new_result(out, config, overwrite=args.overwrite, keep_capture=True) as folder:
        found = pipeline.scan(config, folder, terminal, masks)
    show_outcome(found, out, terminal)
