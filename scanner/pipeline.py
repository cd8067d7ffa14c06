"""The main job from top to bottom: stream → matches → faces → self-calibration → cloud → files.

What was found is written into `folder` also when RefusalError is raised: the matches of a capture that cannot be
calibrated are worth keeping, and the report says why.
"""

from contextlib import ExitStack
from pathlib import Path

from calib.arrays import Bools
from calib.calibration import Calibration
from calib.faces import find_faces
from calib.matches import Matches
from calib.refusal import RefusalError
from calib.selfcalibration import self_calibrate
from hw.open_rig import open_rig
from scanner.calibration_file import write_calibration
from scanner.capture import Stream, capture
from scanner.cloud import CloudStatistics, build_cloud
from scanner.config import Config
from scanner.decode import Decoder
from scanner.findings import Findings, identity, save
from scanner.masks import label_by_masks
from scanner.recording import Recording, record
from scanner.report import CaptureFacts
from scanner.result import CAPTURE_FOLDER, TRUTH_FILE
from scanner.scale import scaled
from scanner.terminal import Terminal

# A calibration whose rays miss each other by more than this, all over the image, is of another rig or of another pose.
_LARGEST_MISS_OF_WIDTH = 0.01
# A calibration from good faces leaves a few hundredths of a pixel; decoders with an uncorrected gamma some tenths.
_LARGEST_MISFIT_PX = 0.5
_LARGEST_MISFIT_OF_NOISE = 2.0


def scan(config: Config, folder: Path, terminal: Terminal, masks: Bools | None = None) -> Findings:
    """Capture with the configured rig, then reconstruct. Raises DeviceError, RefusalError."""
    patterns = config.sequence.patterns(config.projector_size)
    with ExitStack() as devices:
        with terminal.step("Preparing the rig"):
            rig = open_rig(config.required_rig, config.camera_size, config.projector_size)
            opened = devices.enter_context(rig)
        if opened.truth:
            write_calibration(folder / TRUTH_FILE, opened.truth)
        live = capture(opened.rig, patterns)
        found = decode(record(live, folder / CAPTURE_FOLDER), terminal, "Capturing and decoding")
    found.truth = opened.truth
    return reconstruct(found, config, folder, terminal, masks=masks)


def replay(
    recording: Recording,
    config: Config,
    folder: Path,
    terminal: Terminal,
    *,
    masks: Bools | None = None,
    calibration: Calibration | None = None,
) -> Findings:
    """Reconstruct from a recording. Raises InputError for a bad frame, RefusalError."""
    recording.copy_to(folder / CAPTURE_FOLDER)
    found = decode(recording.stream(), terminal, "Decoding")
    return reconstruct(found, config, folder, terminal, masks=masks, calibration=calibration)


def calibrate(matches: Matches, config: Config, folder: Path, terminal: Terminal) -> Findings:
    """Reconstruct from matches, with or without face labels. Raises RefusalError."""
    facts = CaptureFacts(config.camera_size, config.projector_size)
    return reconstruct(Findings(facts, matches), config, folder, terminal)


def decode(stream: Stream, terminal: Terminal, what: str) -> Findings:
    """Frames as they come → matches; no frame is kept."""
    decoder = Decoder(stream.patterns, stream.projector_size)
    exposures_us = []
    for _, frame in terminal.track(stream.frames, len(stream.patterns), what):
        decoder.add(frame.image)
        exposures_us += [frame.exposure_us] if frame.exposure_us else []
    with terminal.step("Matching"):
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
    found: Findings,
    config: Config,
    folder: Path,
    terminal: Terminal,
    *,
    masks: Bools | None = None,
    calibration: Calibration | None = None,
) -> Findings:
    """Matches → calibration (unless one is given) → cloud → files. Raises RefusalError."""
    try:
        if calibration is None:
            with terminal.step("Calibrating"):
                calibration = self_calibration(found, config, masks)
        corner = found.solution.corner if found.solution else None
        found.calibration = scaled(calibration, corner, config.scale)
        with terminal.step("Triangulating"):
            texture = found.decoding.texture if found.decoding else None
            found.cloud = build_cloud(found.matches, texture, found.calibration)
        if not found.solution:
            refuse_foreign(found.cloud.statistics, found.facts.projector_size)
        elif found.solution.method == "refined":  # the paper's method leaves out lenses, so a misfit is to be expected
            refuse_misfit(found.cloud.statistics)
    except RefusalError as refusal:
        save(found, folder, refusal)
        raise
    with terminal.step("Writing the result"):
        save(found, folder)
    return found


def refuse_foreign(statistics: CloudStatistics, projector_size: tuple[int, int]) -> None:
    """Raise RefusalError if, by a given calibration, no rays meet, or all miss by more than lenses explain."""
    advice = "Check that it belongs to this rig, and that nothing has moved since it was made."
    if statistics.kept == 0:
        raise RefusalError("The calibration puts no point in front of both camera and projector.", advice)
    if statistics.calibration_px > _LARGEST_MISS_OF_WIDTH * projector_size[0]:
        raise RefusalError(
            f"With this calibration, rays that should meet miss by {statistics.calibration_px:.0f} projector pixels.",
            advice,
        )


def refuse_misfit(statistics: CloudStatistics) -> None:
    """Raise RefusalError if rays miss each other in a pattern that a calibration made from good faces does not leave.

    All matches have to meet, whatever they are on, but only those on the faces took part in the calibration: where the
    others miss, what was taken for faces of a corner was none.
    """
    if statistics.calibration_px > max(_LARGEST_MISFIT_PX, _LARGEST_MISFIT_OF_NOISE * statistics.decoder_px):
        raise RefusalError(
            f"Beside the faces, rays that should meet miss by {statistics.calibration_px:.2g} projector pixels in a "
            f"pattern, where the decoder's noise is {statistics.decoder_px:.2g}.",
            "What was taken for the faces of a corner may be bent, or not square; or a lens bends more than the method "
            "allows for. Look at the faces in the report, and choose another corner or view.",
        )


def self_calibration(found: Findings, config: Config, masks: Bools | None) -> Calibration:
    """Matches → faces (found, drawn by hand, or labelled already) → calibration. Raises RefusalError."""
    sizes = (found.facts.camera_size, found.facts.projector_size)
    if masks is not None:
        found.matches = label_by_masks(found.matches, masks)
    elif found.matches.face is None:
        found.matches = find_faces(found.matches, *sizes).matches
    found.solution = self_calibrate(
        found.matches,
        *sizes,
        principal_point=config.principal_point(found.facts.camera_size),
        method=config.method,
        squareness_deg=config.corner.squareness_deg,
    )
    return found.solution.calibration
