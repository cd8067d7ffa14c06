"""The main job from top to bottom: stream → matches → faces → self-calibration → cloud → files.

What was found is written into `folder` also when RefusalError is raised: the matches of a capture that cannot be
calibrated are worth keeping, and the report says why.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from calib.diagnostics import Uncertainty
from calib.geometry import Calibration
from calib.numerics import Bools
from hw.open_rig import open_rig
from hw.settings import RigSettings
from scanner.capture import CaptureFacts, Recording, Stream, capture, identity, next_place, open_capture, record
from scanner.configuration import Config
from scanner.decoding import Decoder
from scanner.io import write_calibration
from scanner.reconstruction import (
    calibrate,
    label,
    merge,
    refusal_saved,
    save,
    scaled,
    set_aside,
    triangulate,
)
from scanner.results import CAPTURE_FOLDER, TRUTH_FILE, Decoded, GivenCalibration, Scan
from scanner.ui import Progress, Terminal


def scan(
    config: Config,
    folder: Path,
    terminal: Terminal,
    *,
    number: int = 1,
    masks: Bools | None = None,
    earlier: Sequence[Decoded] = (),
) -> Scan:
    """Capture with the configured rig, from one place or from several, then reconstruct. Raises DeviceError too."""
    captures = [*earlier]
    for step in range(number):
        rig = next_place(config.required_rig, step, number, terminal)
        if rig is None:
            break
        if step:
            set_aside(captures, folder)
        captures.append(take(rig, config, folder, terminal, f"Capture {len(captures) + 1}"))
    return reconstruct(captures, config, folder, terminal, masks=masks)


def take(settings: RigSettings, config: Config, folder: Path, progress: Progress, name: str) -> Decoded:
    """One capture, recorded and decoded as it comes. Raises DeviceError."""
    patterns = config.sequence.patterns(config.projector_size)
    with ExitStack() as devices:
        with progress.step("Preparing the rig"):
            opened = devices.enter_context(open_rig(settings, config.camera_size, config.projector_size))
        if opened.truth:
            write_calibration(folder / TRUTH_FILE, opened.truth)
        live = capture(opened.rig, patterns, config.sequence.exposures_us, config.projector.known_response)
        recorded = folder / CAPTURE_FOLDER

        def again() -> Stream:
            return open_capture(recorded).stream()

        found = decode(record(live, recorded), progress, "Capturing and decoding", name, again=again)
    return replace(found, facts=replace(found.facts, truth=opened.truth))


def replay(
    recording: Recording,
    config: Config,
    folder: Path,
    terminal: Terminal,
    *,
    masks: Bools | None = None,
    earlier: Sequence[Decoded] = (),
) -> Scan:
    """Reconstruct from a recording. Raises InputError for a bad frame, RefusalError."""
    found = _decode_recording(recording, folder, terminal)
    return reconstruct([*earlier, found], config, folder, terminal, masks=masks)


def replay_calibrated(
    recording: Recording,
    calibration: Calibration,
    stated: Uncertainty | None,
    config: Config,
    folder: Path,
    terminal: Terminal,
) -> Scan:
    """The same with a calibration that is known, as is its covariance if `stated`: nothing is calibrated.

    Raises InputError, RefusalError.
    """
    found = _decode_recording(recording, folder, terminal, calibration)
    with refusal_saved([found], folder) as reached:
        given = GivenCalibration(found, scaled(calibration, None, config.scale), stated)
        captures = triangulate([given], reached, terminal)
    return _finished(Scan(captures), folder, terminal)


def _decode_recording(
    recording: Recording, folder: Path, terminal: Terminal, calibration: Calibration | None = None
) -> Decoded:
    recording.copy_to(folder / CAPTURE_FOLDER)
    return decode(recording.stream(), terminal, "Decoding", str(recording.folder), calibration, recording.stream)


def decode(
    stream: Stream,
    progress: Progress,
    what: str,
    name: str = "",
    calibration: Calibration | None = None,
    again: Callable[[], Stream] | None = None,
) -> Decoded:
    """Frames as they come → matches; no frame is kept. With a calibration one axis is enough.

    `again` gives the frames once more, which it takes if each of them shows some of the picture before.
    """
    decoder = Decoder(stream.patterns, stream.projector_size, calibration)
    exposures_us = []
    for _, frame in progress.track(stream.frames, len(stream.patterns), what):
        decoder.add(frame.image, frame.exposure_us)
        exposures_us += [frame.exposure_us] if frame.exposure_us else []
    ghost = decoder.ghost() if again else 0.0
    if again and ghost:
        decoder = Decoder(stream.patterns, stream.projector_size, calibration, ghost=ghost)
        for _, frame in progress.track(again().frames, len(stream.patterns), "Taking out a ghost"):
            decoder.add(frame.image)
    with progress.step("Matching"):
        decoding = decoder.finish()
    about = identity({**stream.metadata, **stream.account()})
    facts = CaptureFacts(stream.camera_size, stream.projector_size, stream.patterns, about, tuple(exposures_us))
    return Decoded(facts, decoding.matches, decoding, name)


def reconstruct(
    captures: Sequence[Decoded], config: Config, folder: Path, progress: Progress, *, masks: Bools | None = None
) -> Scan:
    """Matches → faces → one calibration → clouds → files; `masks` are of the newest capture. Raises RefusalError."""
    with refusal_saved(captures, folder) as reached:
        with progress.step("Calibrating"):
            labelled = label(captures, reached, masks)
            reached[:] = calibrated = calibrate(labelled, config)
        reconstructed = triangulate(calibrated, reached, progress)
        result = Scan(reconstructed)
        if len(captures) > 1 and config.corner.same:
            with progress.step("Merging the clouds"):
                result = Scan(reconstructed, *merge(calibrated, [capture.cloud for capture in reconstructed]))
    return _finished(result, folder, progress)


def _finished(result: Scan, folder: Path, progress: Progress) -> Scan:
    with progress.step("Writing the result"):
        save(result, folder)
    return result
