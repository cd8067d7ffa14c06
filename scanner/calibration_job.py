"""Calibrate from captures that exist: of a corner or, without one, of anything rigid that they share."""

from collections.abc import Sequence
from pathlib import Path

from scanner.configuration import Config
from scanner.errors import InputError
from scanner.io import require_memory
from scanner.objects import calibrate_without_corner
from scanner.reconstruction import is_calibration, read_captures, reconstruct, refuse_impossible
from scanner.results import Scan, new_result
from scanner.stations import read_recording
from scanner.ui import SILENT, Terminal

_BYTES_PER_PIXEL = 50  # of the camera's image, for an organised cloud and its report


def calibrate(
    matches: Sequence[Path], config: Config, out: Path, *, overwrite: bool = False, terminal: Terminal = SILENT
) -> Scan:
    """Calibrate from matches files, results or recordings of one unchanged rig, the newest last, and reconstruct.

    One of them may be a calibration from boards: the estimate is then one over both. Where they show no corner, three
    or more calibrate by what they share. Raises InputError, RefusalError.
    """
    config.principal_point(config.camera_size)
    width, height = config.camera_size
    cloud = f"a cloud and a report for a camera of {width} × {height} pixels"
    require_memory(_BYTES_PER_PIXEL * width * height, cloud, "give the size of the images that were matched")
    sizes = config.camera_size, config.projector_size
    captures = read_captures(matches, *sizes, decode=lambda path: read_recording(path, config, terminal))
    known = tuple(path for path in matches if is_calibration(path))
    if not captures:
        raise InputError(f"{known[0]}: expected captures of a corner to join with this calibration, found none")
    config = config.model_copy(update={"earlier": known})
    refuse_impossible(config, len(captures))
    with new_result(out, config, overwrite=overwrite, tell=terminal.note) as folder:
        without_corner = None if known else calibrate_without_corner
        return reconstruct(captures, config, folder, terminal, without_corner=without_corner)
