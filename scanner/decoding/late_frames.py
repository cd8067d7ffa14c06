"""Frames that are the one before, bit for bit: a projector that was late, or a camera that gave a picture twice.

Noise makes each picture another one. Such a frame does not show its pattern, and no comparison of it means anything:
a fine bit looks unresolved, a coarse one exchanged. It is left out, and mostly its inverse or the other steps of its
fringe tell what it would have shown.
"""

from collections.abc import Sequence

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Image
from scanner.decoding.frame_corrections import saturation_of
from scanner.decoding.light.noise_model import measure_noise
from scanner.decoding.samples import Sample
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.stopped_sequence import usable
from scanner.errors import FramesError, InputError
from scanner.patterns import Pattern
from scanner.shown_text import capitalised

# Every so many rows are compared first.
_ROWS = 61
# Least standard deviation of noise in grey levels, rounding included, at which no two pictures are the same.
_LEAST_NOISE = 0.4

LATE_FRAMES = FindingKind(
    "late-frames",
    "A frame is the one before, bit for bit, as the projector was late or the camera gave a picture twice; left out.",
    "Let the camera wait longer for the projector.",
    ("frames",),
)


def describe_copies(names: str, count: int) -> str:
    """What frames of these names are that are the ones before them, and why."""
    same = "is the frame before it" if count == 1 else "are the frames before them"
    return f"{names} {same}, bit for bit: the projector was late, or the camera gave a picture twice"


def is_copy(frame: Image, previous: Image) -> bool:
    """Whether two frames (H, W) are the same, bit for bit."""
    return np.array_equal(frame[::_ROWS], previous[::_ROWS]) and np.array_equal(frame, previous)


def late_places(plan: SequencePlan, frames: Image, sample: Sample, copies: Sequence[int]) -> list[int]:
    """Those of the `copies` (places of kept frames (N, H, W)) that should show another pattern than the frame before.

    None if there is no noise, without which patterns that differ elsewhere may look the same.
    """
    late = [place for place in copies if plan.shown[place] != plan.shown[place - 1]]
    if not late:
        return []
    noise = measure_noise(plan, sample, saturation_of(plan, frames))
    brightest = sample.levels.max(axis=0)
    return late if float(np.median(noise.sigma(brightest))) > _LEAST_NOISE else []


def patterns_without(
    plan: SequencePlan, late: Sequence[int], projector_size: tuple[int, int], *, calibrated: bool
) -> tuple[list[Pattern | None], Finding]:
    """Return what each frame is decoded as, None if it is left out, and the finding about the late ones.

    Raises FramesError if the rest determines too little.
    """
    numbers = [plan.shown[place] for place in late]
    is_one = len(late) == 1
    problem = describe_copies(plan.names(numbers), len(late))
    kept = [place for place in range(len(plan.shown)) if place not in late]
    try:
        rest = usable([plan.patterns[plan.shown[place]] for place in kept], (), projector_size, calibrated=calibrated)
    except InputError as error:
        raise FramesError(problem, f"without {'it' if is_one else 'them'}, {error}; take the frames again") from error
    decoded_as: list[Pattern | None] = [None] * len(plan.shown)
    for place, pattern in zip(kept, rest.patterns, strict=True):
        decoded_as[place] = pattern
    lost = (
        "what it should show follows from the others" if rest.finding is None else "what needs it is decoded coarsely"
    )
    message = f"{capitalised(problem)}. {'It was' if is_one else 'They were'} left out; {lost}."
    return decoded_as, Finding(LATE_FRAMES, Severity.WARNING, message, LATE_FRAMES.remedy, {"frames": tuple(numbers)})
