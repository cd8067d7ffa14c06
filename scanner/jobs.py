"""The program's jobs as functions: what the commands do, and what other programs can call.

    from scanner import load_config, scan
    found = scan(load_config(Path("configs/room-sim.yaml")), Path("scans/room"))
    found.newest.calibration.camera.focal_px

A result is left in `out`, whole or not at all; also after RefusalError, with the reason in its report.
"""

import re
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from calib.diagnostics import Uncertainty
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, Size
from calib.numerics import Bools
from scanner.acquisition import decode_recording, noting_missing_frames, take, take_captures
from scanner.capture import CAPTURE_FILE, Recording, check_places, open_capture
from scanner.configuration import Config, recorded_config
from scanner.errors import InputError
from scanner.io import read_calibration, refuse_other_sizes, require_memory
from scanner.reconstruction import (
    OnCloud,
    is_calibration,
    lenses_of,
    read_captures,
    read_masks,
    reconstruct,
    refuse_impossible,
)
from scanner.results import CAPTURE_FOLDER, CAPTURES_FOLDER, Decoded, Scan, new_result, read_uncertainty, settle, unused
from scanner.stations import read_recording
from scanner.ui import SILENT, Operator, Progress, Terminal

_BYTES_PER_PIXEL = 50  # of the camera's image, for an organised cloud and its report
_NOT_INCOMPLETE = re.compile(r"-incomplete(-\d+)?$")

RESUMED = FindingKind(
    "resumed",
    "The capture was completed by scan --resume; frames from before the interruption are in the result, too.",
)


def scan(
    config: Config,
    out: Path,
    *,
    captures: int = 1,
    masks: Path | None = None,
    overwrite: bool = False,
    terminal: Terminal = SILENT,
    operator: Operator | None = None,
    progress: Progress | None = None,
    on_cloud: OnCloud | None = None,
) -> Scan:
    """Scan with the configured rig: capture, calibrate, reconstruct.

    Take `captures` of the corner. Between them the rig is moved as a whole; the `operator` is asked to do so (default:
    the `terminal`). `progress` receives the progress (default: the `terminal`); if it raises, the scan ends as by
    Ctrl-C, and what was captured is kept. `on_cloud` is called with the result, in a thread of its own, while it is
    being saved. Raises InputError, DeviceError, RefusalError.
    """
    # Everything that could be refused is checked before the capture.
    if captures < 1:
        raise InputError(f"--captures: expected 1 or more, found {captures}")
    if masks and captures > 1:
        raise InputError("--masks are of one view of the corner, and --captures takes several: give one of them")
    check_places(config.required_rig, captures, operator or terminal)
    earlier, drawn = _read_beside(captures, config, (config.camera_size, config.projector_size), masks, config.earlier)
    with new_result(out, config, overwrite=overwrite, keep_capture=True, tell=terminal.note) as folder:
        taken = take_captures(config, folder, captures, earlier, operator or terminal, progress or terminal)
        return reconstruct(taken, config, folder, progress or terminal, masks=drawn, on_cloud=on_cloud)


def resume(
    folder: Path,
    out: Path | None = None,
    *,
    config: Config | None = None,
    overrides: Sequence[str] = (),
    masks: Path | None = None,
    overwrite: bool = False,
    terminal: Terminal = SILENT,
) -> tuple[Scan, Path]:
    """Complete the capture of an interrupted scan, and make a result of all its captures.

    `folder` stays unchanged. Complete captures in it are calibrated together with this one. `config` (default: the
    recording's own, with KEY=VALUE `overrides`) and `out` (default: the name that the scan would have used) apply to
    the new result. Raises InputError, also if rig or scene have changed, DeviceError, RefusalError.
    """
    named = folder if folder.name not in ("", "..") else folder.absolute()
    out = out or unused(named.with_name(_NOT_INCOMPLETE.sub("", named.name)))
    for sentence in settle(out):
        terminal.note(sentence)
    begun = open_capture(folder / CAPTURE_FOLDER if (folder / CAPTURE_FOLDER).is_dir() else folder)
    settings = config or recorded_config(begun.metadata, str(begun.folder / CAPTURE_FILE), overrides)
    for finding in begun.findings:
        terminal.note(str(finding))
    settings.refuse_other_sizes(folder, begun.camera_size, begun.projector_size)
    whole = [folder] if (folder / CAPTURES_FOLDER).is_dir() else []
    sizes = begun.camera_size, begun.projector_size
    earlier, drawn = _read_beside(1, settings, sizes, masks, [*settings.earlier, *whole])
    with new_result(out, settings, overwrite=overwrite, keep_capture=True, tell=terminal.note) as made:
        name = f"Capture {len(earlier) + 1}"
        taken = take(settings.required_rig, settings, made, terminal, name, begun)
        message = f"The frames that {folder} holds are in this result, too."
        capture = taken.with_findings(Finding(RESUMED, Severity.NOTE, message))
        return reconstruct([*earlier, capture], settings, made, terminal, masks=drawn), out


def replay(
    capture: Path,
    out: Path,
    *,
    config: Config | None = None,
    calibration: Path | None = None,
    masks: Path | None = None,
    overwrite: bool = False,
    keep_recording: bool = True,
    terminal: Terminal = SILENT,
) -> Scan:
    """Reconstruct from a recorded capture; a given `calibration` is used as it is.

    `keep_recording`: copy the recording into the result.

    Raises InputError, RefusalError.
    """
    if masks and calibration:
        raise InputError(
            "--masks selects what to calibrate from, and --calibration replaces calibrating: give one of them"
        )
    settings = config or Config()
    recording = open_capture(capture).in_square_pixels(settings.projector.grid)
    known = _calibration_for(recording, calibration, settings) if calibration else None
    sizes = recording.camera_size, recording.projector_size
    earlier, drawn = _read_beside(1, settings, sizes, masks, settings.earlier)
    with new_result(out, settings, overwrite=overwrite, tell=terminal.note) as folder:
        if keep_recording:
            recording.copy_to(folder / CAPTURE_FOLDER)
        with noting_missing_frames(recording):
            decoded = decode_recording(recording, terminal, known[0] if known else None)
            if known is None:
                return reconstruct([*earlier, decoded], settings, folder, terminal, masks=drawn)
        return reconstruct([decoded], settings, folder, terminal, given=known)


def calibrate(
    matches: Sequence[Path], config: Config, out: Path, *, overwrite: bool = False, terminal: Terminal = SILENT
) -> Scan:
    """Calibrate from matches files, results or recordings of one unchanged rig, the newest last, and reconstruct.

    One of them may be a calibration from boards: the estimate is then one over both. Where they show no corner, three
    or more calibrate by what they share. Raises InputError, RefusalError.
    """
    captures, config = read_to_calibrate(matches, config, terminal)
    return calibrate_captures(captures, config, out, overwrite=overwrite, terminal=terminal)


def read_to_calibrate(matches: Sequence[Path], config: Config, terminal: Terminal) -> tuple[list[Decoded], Config]:
    """The captures among what `calibrate` is given, and the configuration with the calibration among it.

    Raises InputError, also if no calibration of them is possible.
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
    return captures, config


def calibrate_captures(
    captures: Sequence[Decoded], config: Config, out: Path | None, *, overwrite: bool = False, terminal: Terminal
) -> Scan:
    """Calibrate from what `read_to_calibrate` returns, and reconstruct; without `out`, nothing is written.

    Raises InputError, RefusalError.
    """
    from scanner.objects import calibrate_without_corner  # slow to import, and no other job needs it

    without_corner = None if config.earlier else calibrate_without_corner
    kept = nullcontext() if out is None else new_result(out, config, overwrite=overwrite, tell=terminal.note)
    with kept as folder:
        return reconstruct(captures, config, folder, terminal, without_corner=without_corner)


def _read_beside(
    taken: int, config: Config, sizes: tuple[Size, Size], masks: Path | None, captures: Sequence[Path]
) -> tuple[list[Decoded], Bools | None]:
    """The `captures` that are calibrated with so many that are `taken`, and the masks of the newest.

    Raises InputError, also if no calibration of all of them is possible.
    """
    config.principal_point(sizes[0])
    drawn = read_masks(masks, sizes[0]) if masks else None
    earlier = read_captures(captures, *sizes)
    lenses_of(config, *sizes)
    refuse_impossible(config, len(earlier) + taken)
    return earlier, drawn


def _calibration_for(recording: Recording, path: Path, config: Config) -> tuple[Calibration, Uncertainty | None]:
    """A calibration that was given for a recording, with its covariance if the file states one.

    Raises InputError if it is of another rig.
    """
    calibration = read_calibration(path)
    sizes, expected = calibration.sizes, (recording.camera_size, recording.projector_size)
    refuse_other_sizes(path, sizes, expected, "the capture's", ": this calibration belongs to another rig")
    if config.earlier:
        raise InputError(
            "'earlier' adds captures to calibrate from, and --calibration replaces calibrating: give one "
            "of them, as with --set earlier=[]"
        )
    return calibration, read_uncertainty(path, calibration)
