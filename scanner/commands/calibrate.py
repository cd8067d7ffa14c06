"""Calibrate from matches that another decoder found, or from those of an earlier result."""

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.arrays import Floats, Ints
from calib.matches import NO_FACE
from scanner import pipeline
from scanner.commands import options
from scanner.commands.outcome import show_outcome
from scanner.config import load_config
from scanner.errors import InputError
from scanner.matches_file import read_matches
from scanner.result import new_result
from scanner.terminal import Terminal

# Undistorted or extrapolated pixels may lie outside of the image, but not far.
_MARGIN_OF_SIZE = 0.1


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("matches", type=Path, nargs="+", metavar="MATCHES", help="matches.npz, or a result folder")
    options.add_config(parser, required=True)
    options.add_out(parser)
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    if len(args.matches) > 1:
        raise InputError(
            f"expected one matches file, found {len(args.matches)}: joint calibration of several captures is not "
            "available in this version"
        )
    (path,) = args.matches
    config = load_config(args.config, args.set)
    config.principal_point(config.camera_size)
    matches = read_matches(path)
    _check_inside(path, "camera", matches.camera_px, config.camera_size)
    _check_inside(path, "projector", matches.projector_px, config.projector_size)
    matches = replace(matches, face=_three_faces(path, matches.face))
    terminal = Terminal(quiet=args.quiet)
    with new_result(args.out, config, overwrite=args.overwrite) as folder:
        found = pipeline.calibrate(matches, config, folder, terminal)
    show_outcome(found, args.out, terminal)


def _check_inside(path: Path, device: str, pixels: Floats, size: tuple[int, int]) -> None:
    for axis, (name, length) in enumerate(zip(("width", "height"), size, strict=True)):
        low, high = pixels[:, axis].min(), pixels[:, axis].max()
        if low < -_MARGIN_OF_SIZE * length or high > (1 + _MARGIN_OF_SIZE) * length:
            raise InputError(
                f"{path}: {device}_px runs from {low:.0f} to {high:.0f} in {'xy'[axis]}, but the configuration's "
                f"{device}.{name} is {length}"
            )


def _three_faces(path: Path, face: Ints | None) -> Ints | None:
    """Labels 0, 1, 2 in the order of the file's labels; None if no match has one, so that faces have to be found."""
    if face is None or np.all(face == NO_FACE):
        return None
    labels = np.unique(face[face != NO_FACE])
    if len(labels) != 3:
        raise InputError(f"{path}: 'face' must label three faces, found {len(labels)}: {', '.join(map(str, labels))}")
    return np.where(face == NO_FACE, NO_FACE, np.searchsorted(labels, face)).astype(np.int32)
