"""Calibrate an ordinary camera from photos of a corner."""

from collections.abc import Sequence
from pathlib import Path

from calib.geometry import Matches
from scanner.commands.options_of_scans import PhotosCommand
from scanner.commands.outcome import show_outcome
from scanner.errors import InputError
from scanner.photos import Photo, PhotoOptions, principal_point, read_photos, reconstruct_photos, refuse_unsuitable
from scanner.reconstruction import read_captures, read_masks
from scanner.results import new_result
from scanner.ui import Terminal


def run(args: PhotosCommand) -> None:
    """Do the work. Raises InputError, RefusalError."""
    if len(args.photos) < 2:
        raise InputError(f"expected two photos or more, found {len(args.photos)}: one photo shows no depth")
    config = args.settings.load()
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
    terminal = Terminal(quiet=args.output.quiet)
    out = args.output.place()
    with new_result(out, config, overwrite=args.output.overwrite, tell=terminal.note) as folder:
        scan = reconstruct_photos(photos, wanted, config, folder, terminal)
    show_outcome(scan, out, terminal, args.output.require)


def _given(path: Path, photos: Sequence[Photo]) -> Matches:
    if len(photos) != 2:
        raise InputError(f"--matches are those of two photos, found {len(photos)}")
    (matches,) = read_captures([path], photos[0].size, photos[1].size)
    return matches.matches
