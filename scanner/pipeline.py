"""The main job from top to bottom: stream → matches → faces → self-calibration → cloud → files.

What was found is written into `folder` also when RefusalError is raised: the matches of a capture that cannot be
calibrated are worth keeping, and the report says why.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from calib.geometry import Calibration
from calib.numerics import Bools
from calib.pointcloud import build_cloud
from calib.refusal import RefusalError
from hw.open_rig import open_rig
from hw.settings import RigSettings
from scanner.capture import CaptureFacts, Recording, Stream, capture, identity, next_place, record
from scanner.configuration import Config
from scanner.decoding import Decoder
from scanner.io import write_calibration
from scanner.reconstruction import merge, refuse_foreign, refuse_misfit, save, scaled, self_calibration, set_aside
from scanner.results import CAPTURE_FOLDER, TRUTH_FILE, Findings, Scan
from scanner.ui import Progress, Terminal


def scan(
    config: Config,
    folder: Path,
    terminal: Terminal,
    *,
    number: int = 1,
    masks: Bools | None = None,
    earlier: Sequence[Findings] = (),
) -> Scan:
    """Capture with the configured rig, from one place or from several, then reconstruct. Raises DeviceError too."""
    captures = [*earlier]
    for step in range(number):
        rig = next_place(config.required_rig, step, number, terminal)
        if rig is None:
            break
        if step:
            set_aside(captures, folder)
        captures.append(take(rig, config, folder, terminal))
        captures[-1].name = f"Capture {len(captures)}"
    return reconstruct(Scan(captures), config, folder, terminal, masks=masks)


def take(settings: RigSettings, config: Config, folder: Path, progress: Progress) -> Findings:
    """One capture, recorded and decoded as it comes. Raises DeviceError."""
    patterns = config.sequence.patterns(config.projector_size)
    with ExitStack() as devices:
        with progress.step("Preparing the rig"):
            opened = devices.enter_context(open_rig(settings, config.camera_size, config.projector_size))
        if opened.truth:
            write_calibration(folder / TRUTH_FILE, opened.truth)
        live = capture(opened.rig, patterns, config.sequence.exposures_us, config.projector.known_response)
        found = decode(record(live, folder / CAPTURE_FOLDER), progress, "Capturing and decoding")
    found.truth = opened.truth
    return found


def replay(
    recording: Recording,
    config: Config,
    folder: Path,
    terminal: Terminal,
    *,
    masks: Bools | None = None,
    calibration: Calibration | None = None,
    earlier: Sequence[Findings] = (),
) -> Scan:
    """Reconstruct from a recording. Raises InputError for a bad frame, RefusalError."""
    recording.copy_to(folder / CAPTURE_FOLDER)
    found = decode(recording.stream(), terminal, "Decoding")
    found.name = str(recording.folder)
    return reconstruct(Scan([*earlier, found]), config, folder, terminal, masks=masks, calibration=calibration)


def calibrate(captures: Sequence[Findings], config: Config, folder: Path, terminal: Terminal) -> Scan:
    """Reconstruct from matches, with or without face labels. Raises RefusalError."""
    return reconstruct(Scan(captures), config, folder, terminal)


def decode(stream: Stream, progress: Progress, what: str) -> Findings:
    """Frames as they come → matches; no frame is kept."""
    decoder = Decoder(stream.patterns, stream.projector_size)
    exposures_us = []
    for _, frame in progress.track(stream.frames, len(stream.patterns), what):
        decoder.add(frame.image, frame.exposure_us)
        exposures_us += [frame.exposure_us] if frame.exposure_us else []
    with progress.step("Matching"):
        decoding = decoder.finish()
    about = identity({**stream.metadata, **stream.account()})
    facts = CaptureFacts(
        stream.camera_size,
        stream.projector_size,
        stream.patterns,
        about,
        tuple(exposures_us),
    )
    return Findings(facts, decoding.matches, decoding)


def reconstruct(
    scan: Scan,
    config: Config,
    folder: Path,
    progress: Progress,
    *,
    masks: Bools | None = None,
    calibration: Calibration | None = None,
) -> Scan:
    """Matches → calibration (unless one is given) → clouds → files. Raises RefusalError."""
    try:
        if calibration is None:
            with progress.step("Calibrating"):
                calibration = self_calibration(scan, config, masks)
        corner = scan.newest.solution.corner if scan.newest.solution else None
        calibration = scaled(calibration, corner, config.scale)
        for found in scan.captures:
            with progress.step("Triangulating"), scan.naming(found):
                triangulate(found, calibration)
        if len(scan.captures) > 1 and config.corner.same:
            with progress.step("Merging the clouds"):
                merge(scan)
    except RefusalError as refusal:
        save(scan, folder, refusal)
        raise
    with progress.step("Writing the result"):
        save(scan, folder)
    return scan


def triangulate(found: Findings, calibration: Calibration) -> None:
    """One capture's matches → its cloud, unless they refute the calibration. Raises RefusalError."""
    found.calibration = calibration
    found.cloud = build_cloud(found.matches, found.texture, calibration)
    if not found.solution:
        refuse_foreign(found.cloud.statistics, found.facts.projector_size)
    elif found.solution.method == "refined":  # the paper's method leaves out lenses, so a misfit is to be expected
        refuse_misfit(found.cloud.statistics)
