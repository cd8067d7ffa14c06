"""The camera's picture under white light, from a result's recording."""

from pathlib import Path

from scanner.capture import open_capture
from scanner.errors import InputError
from scanner.rendering import LONGEST_SIDE, Pixels, photograph
from scanner.results import CAPTURE_FOLDER


def read_white_picture(folder: Path, longest_side: int = LONGEST_SIDE) -> Pixels | None:
    """RGB (H, W, 3), reduced; None where a result has no recording, or that no white picture."""
    try:
        white = open_capture(folder / CAPTURE_FOLDER).white()
    except InputError:
        return None
    return None if white is None else photograph(white, longest_side)
