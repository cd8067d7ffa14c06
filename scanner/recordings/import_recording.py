"""Import a recording into a capture folder."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from scanner.capture import CAPTURE_FILE, SMOOTH_KEY
from scanner.io import flow_yaml, write_png
from scanner.patterns import FORMAT, aspect_to_dict, frame_line, size_to_dict
from scanner.recordings.averaging import average, image_of, noise_of, smooth_px
from scanner.recordings.clock_fit import fit_times_and_clocks
from scanner.recordings.clocks import Clocks, exposure_text, find_loops
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples, take_samples
from scanner.recordings.steadiness import exposure_range, findings_on_steadiness, moved_px, white_frames
from scanner.recordings.video_file import open_video
from scanner.recordings.weights import PictureWeights, picture_weights
from scanner.results import finding_entries
from scanner.ui import Progress

_PPM = 1e6
_UNEVEN_MS = 0.3  # scatter of changes

OPEN_EXPOSURE = FindingKind(
    "open-exposure",
    "A film does not determine its exposure.",
)
LATE_CHANGES = FindingKind(
    "late-changes",
    "Pictures of a film changed off their time, which was taken into account: frames were dropped or shown twice.",
    "Close other programs on the player's computer.",
    ("changes", "off_ms"),
)
UNMIXED_ROWS = FindingKind(
    "unmixed-rows",
    "Rows of a film's pictures were unmixed from frames that show two pictures.",
    "Film with more frames a second, a shorter exposure, or a longer --hold.",
    ("unmixed_share",),
)
LOST_ROWS = FindingKind(
    "lost-rows",
    "Rows of a film's pictures are lost, for they could not be separated from other pictures.",
    "Film with more frames a second, a shorter exposure, or a longer --hold.",
    ("lost_share",),
)


@dataclass(frozen=True)
class Imported:
    """What was found out about a recording; `frames_per_picture`: on average over pictures and rows.

    `smooth_px`: see `smooth_px`; None if it cannot be measured.
    """

    clocks: Clocks
    frames_per_picture: float
    smooth_px: float | None
    findings: tuple[Finding, ...]


def import_recording(path: Path, programme: Programme, folder: Path, progress: Progress) -> Imported:
    """`capture.yaml` and `frames/`, into an existing folder. Raises InputError, OSError."""
    video = open_video(path, programme.length_s)
    samples = take_samples(video, progress)
    marks = find_loops(samples, programme)
    with progress.step("Finding both clocks"):
        samples, clocks = fit_times_and_clocks(samples, programme, marks.loops)
        weights = picture_weights(samples, programme, clocks)
    whites = white_frames(samples, programme, clocks)
    averaged = average(video, weights, clocks.tone, len(samples.times_s), whites, progress)
    smooth = smooth_px(programme, weights, averaged)
    exposure = exposure_range(samples, whites, clocks)
    findings = (
        *marks.findings,
        *_on_exposure(clocks),
        *_on_changes(clocks),
        *_on_rows(weights),
        *findings_on_steadiness(path, moved_px(averaged.kept), exposure),
    )
    imported = Imported(clocks, float(np.mean([_frames(weight) for weight in weights])), smooth, findings)
    noise = noise_of(samples, weights, clocks)
    (folder / "frames").mkdir()
    lines = [f"{flow_yaml(key)}: {flow_yaml(value)}\n" for key, value in _header(samples, programme, imported).items()]
    lines.append("frames:\n")
    pictures = zip(averaged.pictures, programme.patterns, weights, noise, strict=True)
    for number, (light, pattern, frame_weights, sigma) in enumerate(
        progress.track(pictures, len(weights), "Writing the frames")
    ):
        file = f"frames/{number:03d}.png"
        write_png(folder / file, image_of(light, video.quarter_turns))
        more = {
            "averaged": round(_frames(frame_weights), 2),
            "alone": round(frame_weights.alone, 3),
            "noise": float(f"{sigma:.3g}"),
        }
        lines.append(frame_line(file, pattern, **more))
    (folder / CAPTURE_FILE).write_text("".join(lines), encoding="utf-8")
    return imported


def _frames(weights: PictureWeights) -> float:
    """Return the number of frames that make a picture: the median over its rows."""
    return float(np.median(np.count_nonzero(weights.weights, axis=0)))


def _header(samples: VideoSamples, programme: Programme, imported: Imported) -> dict[str, object]:
    clocks, (width, height) = imported.clocks, samples.video.size
    upright = (height, width) if samples.video.quarter_turns % 2 else (width, height)
    slot_s = float(np.mean([loop.slot_s for loop in clocks.loops]))
    statement = {
        "file": samples.video.path.name,
        "frames": len(samples.times_s),
        "frames_per_second": round(1 / samples.frame_interval_s, 3),
        **_exposure(clocks, height),
        "projector_slower_ppm": round(_PPM * (slot_s / programme.hold_s - 1)),
        "scatter_of_changes_ms": round(1e3 * clocks.scatter_s, 2),
        "tone_exponent": round(clocks.tone.exponent, 3),
        "tone_contrast": round(clocks.tone.contrast, 3),
        **({} if imported.smooth_px is None else {SMOOTH_KEY: float(f"{imported.smooth_px:.3g}")}),
        "loops_s": [round(float(loop.start_s), 4) for loop in clocks.loops],
        "findings": finding_entries(imported.findings),
    }
    return {
        "format": FORMAT,
        "projector": size_to_dict(programme.size),
        **aspect_to_dict(programme.grid),
        "camera": size_to_dict(upright),
        "imported from": "a recording",
        "recording": statement,
    }


def _exposure(clocks: Clocks, height: int) -> dict[str, object]:
    """Exposure and readout, or the range of exposures if the film does not determine them."""
    if not clocks.has_exposure:
        return {"exposure_range_ms": [round(1e3 * exposure_s, 2) for exposure_s in clocks.exposures_s]}
    return {"exposure_ms": round(1e3 * clocks.exposure_s, 2), "readout_ms": round(1e3 * clocks.line_s * height, 2)}


def _on_exposure(clocks: Clocks) -> Iterator[Finding]:
    if clocks.has_exposure:
        return
    scatter_ms = 1e3 * clocks.scatter_s
    if scatter_ms >= _UNEVEN_MS:
        message = (
            f"The exposure is not determined: pictures changed {scatter_ms:.1f} ms off their time (root mean square), "
            "as where frames come unevenly. Frames next to a change are left out."
        )
    else:
        message = (
            f"Exposures {exposure_text(clocks)} explain the film alike, with a readout in proportion: pictures changed "
            "at the same moments of the frames throughout. The capture is the same with any of them."
        )
    yield Finding(OPEN_EXPOSURE, Severity.NOTE, message)


def _on_changes(clocks: Clocks) -> Iterator[Finding]:
    shifts = np.abs(np.concatenate(clocks.shifts_s))
    late = int(np.count_nonzero(shifts))
    if late:
        yield Finding(
            LATE_CHANGES,
            Severity.NOTE,
            f"{late} changes of the picture came up to {1e3 * shifts.max():.0f} ms off their time, which was taken "
            "into account: the player or the camera dropped frames or showed some twice.",
            data={"changes": float(late), "off_ms": 1e3 * float(shifts.max())},
        )


def _on_rows(weights: list[PictureWeights]) -> Iterator[Finding]:
    unmixed = 1 - float(np.mean([frame_weights.alone for frame_weights in weights]))
    lost = float(np.mean([np.mean(~weight.weights.any(axis=0)) for weight in weights]))
    if unmixed > 0:
        message = f"{unmixed:.1%} of the pictures' rows were unmixed from frames that show two pictures."
        yield Finding(UNMIXED_ROWS, Severity.NOTE, message, data={"unmixed_share": unmixed})
    if lost > 0:
        message = f"{lost:.1%} of the pictures' rows are lost: they could not be separated from other pictures."
        yield Finding(LOST_ROWS, Severity.NOTE, message, data={"lost_share": lost})
