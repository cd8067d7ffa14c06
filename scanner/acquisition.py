"""Captures, taken now or recorded before: streams of frames, decoded as they come, become matches."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration
from calib.refusal import RefusalError
from hw.ahead import in_background
from hw.backends import RigSettings
from hw.open_rig import OpenedRig, open_rig
from scanner.capture import (
    CaptureMetadata,
    Recording,
    Stream,
    capture_together,
    findings_on_camera,
    findings_on_lines,
    identity,
    known_of_lines,
    measure_lines,
    next_place,
    record,
    shows_single_pixels,
    take_up,
    with_smooth_errors_of_film,
)
from scanner.configuration import CONFIGURATION_KEY, Config
from scanner.decoding import Decoder, usable
from scanner.errors import InputError
from scanner.io import require_space, write_calibration
from scanner.patterns import aspect_to_dict
from scanner.reconstruction import (
    guide,
    set_aside,
)
from scanner.results import AS_SHOWN, CAPTURE_FOLDER, TRUTH_FILE, Decoded
from scanner.ui import Operator, Progress

# Bytes of matches and cloud per camera pixel.
_RESULT_BYTES_PER_PIXEL = 75

RESUMABLE = FindingKind(
    "resumable",
    "The recording was interrupted, and names the patterns that it lacks.",
    "Complete it with scan --resume, if the rig still stands there.",
)


def take_captures(
    config: Config, folder: Path, number: int, earlier: Sequence[Decoded], operator: Operator, progress: Progress
) -> list[Decoded]:
    """The `earlier` captures, and so many that are taken now, from as many places; fewer if the operator ends.

    Between captures, the `operator` is told their accuracy so far, and asked to move the rig. Raises DeviceError,
    StorageError.
    """
    captures = [*earlier]
    enough = False
    for step in range(number):
        rig = next_place(config.required_rig, step, number, operator, enough=enough)
        if rig is None:
            break
        if step:
            set_aside(captures, folder)
        captures.append(take(rig, config, folder, progress, f"Capture {len(captures) + 1}"))
        if step + 1 < number:
            with progress.step("Working out where to go next"):
                guidance, captures = guide(captures, config)
            operator.tell(*guidance.sentences)
            enough = guidance.enough
    return captures


def _additional_truth(opened: OpenedRig) -> dict[str, Any]:
    """Additional entries of truth.yaml: the pose of the rig, and the thing's volume and area, in metres."""
    entries: dict[str, Any] = {}
    if opened.place is not None:
        place = opened.place
        entries["place"] = {"rotation": place.rotation.tolist(), "translation": place.translation.tolist()}
    if opened.thing is not None:
        entries["thing"] = {"volume": opened.thing.volume, "area": opened.thing.area}
    return entries


def take(
    settings: RigSettings,
    config: Config,
    folder: Path,
    progress: Progress,
    name: str,
    begun: Recording | None = None,
) -> Decoded:
    """Record and decode a capture, or the rest of a `begun` one.

    Raises DeviceError, StorageError if there is no room for it.
    """
    rig = open_rig(settings, config.camera_size, config.projector_size, config.projector.grid)
    (capture,) = take_together(rig, [PlannedCapture(name, config, folder)], progress, begun)
    return capture


@dataclass(frozen=True)
class PlannedCapture:
    """A capture by one camera, which is recorded in `folder`."""

    name: str
    config: Config
    folder: Path

    @property
    def frames(self) -> int:
        """How many are to be taken."""
        sequence = self.config.sequence
        return len(sequence.patterns(self.config.projector_size)) * max(1, len(sequence.exposures_us))

    @property
    def bytes(self) -> int:
        """What it needs on the disk at most, with its result."""
        per_pixel = self.frames * self.config.required_rig.bytes_per_pixel + _RESULT_BYTES_PER_PIXEL
        return prod(self.config.camera_size) * per_pixel


def take_together(
    rig: AbstractContextManager[OpenedRig],
    planned: Sequence[PlannedCapture],
    progress: Progress,
    begun: Recording | None = None,
) -> list[Decoded]:
    """A capture by each camera of a rig, in its order, while the projector shows the patterns of the first once.

    Each is recorded and decoded as it comes. If a camera fails, all end; what they have captured stays. Raises
    DeviceError, StorageError if there is no room for them.
    """
    first, count = planned[0].config, sum(each.frames for each in planned)
    how_many = "a capture" if len(planned) == 1 else f"{len(planned)} captures"
    frames = f"{how_many} of {count} frames of {first.camera_size} px, with results,"
    require_space(planned[0].folder, count, sum(each.bytes for each in planned), frames)
    with ExitStack() as devices:
        with progress.step("Preparing the rig"):
            opened = devices.enter_context(rig)
            grid = first.projector.grid
            lines = measure_lines(opened.rig, grid) if begun is None else [known_of_lines(begun.metadata)]
        for each, plan in zip(opened.all, planned, strict=True):
            if each.truth:
                write_calibration(plan.folder / TRUTH_FILE, each.truth, _additional_truth(each))
        patterns = first.sequence.patterns(first.projector_size)
        how = patterns, first.sequence.exposures_us, first.projector.known_response
        live = capture_together(opened.rig, *how) if begun is None else (take_up(begun, opened.rig, *how),)
        streams = [
            replace(
                stream,
                metadata={
                    **stream.metadata,
                    **of_lines,
                    **aspect_to_dict(grid),
                    CONFIGURATION_KEY: plan.config.recorded,
                },
            )
            for stream, of_lines, plan in zip(live, lines, planned, strict=True)
        ]
        recorded = [record(stream, plan.folder / CAPTURE_FOLDER) for stream, plan in zip(streams, planned, strict=True)]
        decoded = decode(recorded, progress, "Capturing and decoding", [plan.name for plan in planned])
        captures = [
            _with_account(capture, stream.metadata, stream.account())
            for capture, stream in zip(decoded, streams, strict=True)
        ]
    return [
        replace(capture, metadata=replace(capture.metadata, truth=of_rig.truth))
        for capture, of_rig in zip(captures, opened.all, strict=True)
    ]


def decode_recording(recording: Recording, terminal: Progress, calibration: Calibration | None = None) -> Decoded:
    """As much of it as determines something."""
    sequence = usable(
        recording.patterns, recording.planned, recording.projector_size, calibrated=calibration is not None
    )
    stream = recording.stream().shown_as(sequence.patterns)
    (capture,) = decode([stream], terminal, "Decoding", [str(recording.folder)], calibration)
    capture = _with_account(capture, recording.metadata, recording.metadata)
    return capture.with_findings(*recording.findings, *filter(None, [sequence.finding, _resumption(recording)]))


def _with_account(capture: Decoded, metadata: Mapping[str, object], account: Mapping[str, object]) -> Decoded:
    """The capture with what its metadata say of the projector's pixels, and the camera's account."""
    if shows_single_pixels(metadata):
        capture = replace(capture, panel=AS_SHOWN)
    return capture.with_findings(*findings_on_lines(metadata), *findings_on_camera(account))


def _resumption(recording: Recording) -> Finding | None:
    if len(recording.planned) <= len(recording.patterns):
        return None
    message = f"scan --resume {recording.folder} takes the missing frames, if the rig still stands there."
    return Finding(RESUMABLE, Severity.WARNING, message)


@contextmanager
def noting_missing_frames(recording: Recording) -> Iterator[None]:
    """If a capture fails, say that it was interrupted, which may be the cause."""
    try:
        yield
    except (InputError, RefusalError) as error:
        for finding in filter(None, [*recording.findings, _resumption(recording)]):
            error.add_note(str(finding))
        raise


def decode(
    streams: Sequence[Stream],
    progress: Progress,
    what: str,
    names: Sequence[str] = ("",),
    calibration: Calibration | None = None,
) -> list[Decoded]:
    """The matches of each of the streams, whose patterns are the same, while their frames come.

    `what`: is done, for the progress; `names`: of the captures. With a `calibration` one axis is enough. Raises
    InputError.
    """
    decoders = [Decoder(stream.patterns, stream.projector_size, calibration) for stream in streams]
    exposures_us = _added(decoders, streams, progress, what)
    captures = []
    with progress.step("Matching"):
        for stream, decoder, exposures, name in zip(streams, decoders, exposures_us, names, strict=True):
            decoding = decoder.finish()
            decoding = replace(decoding, smooth_px=with_smooth_errors_of_film(decoding.smooth_px, stream.metadata))
            about = identity({**stream.metadata, **stream.account()})
            sizes = stream.camera_size, stream.projector_size
            metadata = CaptureMetadata(*sizes, stream.patterns, about, tuple(exposures))
            captures.append(Decoded(metadata, decoding.matches, decoding, name))
    return captures


def _added(decoders: Sequence[Decoder], streams: Sequence[Stream], progress: Progress, what: str) -> list[list[float]]:
    """Add all frames of each stream to its decoder; return their exposures in µs, as far as they are known."""
    exposures_us: list[list[float]] = [[] for _ in streams]
    with ExitStack() as running:
        adding = [running.enter_context(in_background(decoder.add)) for decoder in decoders]
        frames = zip(*(stream.frames for stream in streams), strict=True)
        for taken in progress.track(frames, len(streams[0].patterns), what):
            for (_, frame), add, exposures in zip(taken, adding, exposures_us, strict=True):
                add(frame.image, frame.exposure_us)
                exposures += [frame.exposure_us] if frame.exposure_us else []
    return exposures_us
