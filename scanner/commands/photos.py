"""Calibrate an ordinary camera from two or more photos of a corner, and reconstruct what they share.

The photos may be cropped, if all of them are in the same way: the principal point is found, too. The zoom must not
change between them. The second photo is the one that the result is about.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path

from calib.geometry import Matches
from scanner.commands import options
from scanner.commands.outcome import show_outcome
from scanner.configuration import load_config
from scanner.errors import InputError
from scanner.photos import Photo, PhotoOptions, principal_point, read_photos, reconstruct_photos, refuse_unsuitable
from scanner.reconstruction import read_captures, read_masks
from scanner.results import new_result
from scanner.ui import Terminal


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "photos", type=Path, nargs="+", metavar="PHOTO", help="photos of one corner by one camera at one zoom"
    )
    parser.add_argument(
        "--matches",
        type=Path,
        metavar="FILE",
        help="matches.npz of the two photos: camera_px in the first, projector_px in the second",
    )
    options.add_masks(parser)
    parser.add_argument(
        "--exif-prior", action="store_true", help="use the EXIF focal length (± 5 %%), which is otherwise only shown"
    )
    parser.add_argument("--dense", action="store_true", help="match every pixel of the first two photos: dense.ply")
    options.add_config(parser, required=False)
    options.add_out(parser)
    options.add_overwrite(parser)
    options.add_quiet(parser)


def run(args: Namespace) -> None:
    """Do the work. Raises InputError, RefusalError."""
    if len(args.photos) < 2:
        raise InputError(f"expected two photos or more, found {len(args.photos)}: one photo shows no depth")
    config = load_config(args.config, args.set)
    refuse_unsuitable(config)
    photos = read_photos(args.photos)
    size = photos[0].size
    principal_point(config, size)
    wanted = PhotoOptions(
        matches=_given(args.matches, photos) if args.matches else None,
        masks=read_masks(args.masks, size) if args.masks else None,
        exif_prior=args.exif_prior,
        dense=args.dense,
    )
    terminal = Terminal(quiet=args.quiet)
    with new_result(args.out, config, overwrite=args.overwrite) as folder:
        scan = reconstruct_photos(photos, wanted, config, folder, terminal)
    show_outcome(scan, args.out, terminal)
    focal_px = photos[0].focal_px
    used = "used as a prior" if args.exif_prior else "not used; --exif-prior uses it"
    terminal.show("EXIF: no focal length" if focal_px is None else f"EXIF: focal length {focal_px:.0f} px ({used})")


def _given(path: Path, photos: Sequence[Photo]) -> Matches:
    if len(photos) != 2:
        raise InputError(f"--matches are those of two photos, found {len(photos)}")
    (found,) = read_captures([path], photos[0].size, photos[1].size)
    return found.matches
