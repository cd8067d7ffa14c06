"""The frames of a capture: kept as they were taken, and read as they would be without the effects that are corrected.

They are kept in memory, or in a memory-mapped file if they are large, or refused.

A frame that is the one before, bit for bit, comes from a projector that was late, or a camera that gave a picture
twice: noise makes each picture another one. It does not show its pattern, and no comparison of it means anything: a
fine bit looks unresolved, a coarse one exchanged. It is left out, and mostly its inverse or the other steps of its
fringe tell what it would have shown.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import prod
from tempfile import TemporaryFile
from typing import Any

import cv2
import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import WHOLE, Image, Part
from scanner.decoding.corrections.camera_response import CameraResponse, camera_response
from scanner.decoding.corrections.ghost import Ghost, find_ghost, without_ghost
from scanner.decoding.light import (
    AmbientLightChange,
    Sample,
    measure_noise,
    saturation_level,
    unclipped,
    without_change,
)
from scanner.decoding.planning import usable
from scanner.decoding.sequence_plan import SequencePlan
from scanner.errors import FramesError, InputError
from scanner.io import require_memory, total_bytes
from scanner.patterns import Pattern
from scanner.shown_text import capitalised

# Share of the machine's memory above which frames are mapped from a file.
_MOST_OF_MEMORY = 0.25
# Peak use, with 16-bit frames and a match at every pixel; with codes only, edges and all pairs are kept as well.
_BYTES_PER_PIXEL, _OF_CODES_ALONE = 70, 136


class Stack:
    """The grey frames (N, H, W) of a capture, in the order in which they were taken.

    A frame is a view that keeps all of them in memory. Raises InputError if there is not enough memory to decode them,
    or not enough room for the file.
    """

    def __init__(self, count: int, first: Image, *, codes_alone: bool) -> None:
        shape = first.shape[0], first.shape[1]
        needed, memory = count * shape[0] * shape[1] * first.itemsize, total_bytes()
        is_mapped = memory is not None and needed > _MOST_OF_MEMORY * memory
        require_decoding_memory(shape, 0 if is_mapped else needed, codes_alone=codes_alone)
        frames = _mapped((count, *shape), first.dtype) if is_mapped else np.empty((count, *shape), first.dtype)
        self._frames: Image = frames
        self._count = 0

    @property
    def frames(self) -> Image:
        """(N, H, W): the frames kept so far."""
        return self._frames[: self._count]

    def keep(self, image: Image) -> Image:
        """Store the next frame, (H, W) grey or (H, W, 3) BGR; return the stored grey copy."""
        kept: Image = self._frames[self._count]
        if image.ndim == 3:
            cv2.cvtColor(image, cv2.COLOR_BGR2GRAY, dst=kept)
        else:
            np.copyto(kept, image)
        self._count += 1
        return kept


def require_decoding_memory(shape: tuple[int, int], kept_bytes: int, *, codes_alone: bool) -> None:
    """Raise InputError if decoding frames (H, W) takes more memory than is free.

    `kept_bytes`: memory of the kept frames.
    """
    needed = kept_bytes + shape[0] * shape[1] * (_OF_CODES_ALONE if codes_alone else _BYTES_PER_PIXEL)
    frames = f"frames of {shape[1]} × {shape[0]} pixels, to be decoded,"
    require_memory(needed, frames, "reduce the frames and the camera's size with them")


def _mapped(shape: tuple[int, int, int], dtype: np.dtype[Any]) -> Image:
    """Return an array of this shape, mapped from a file that is deleted when the array is released."""
    count = prod(shape) * dtype.itemsize
    try:
        with TemporaryFile(prefix="roomscan-") as file:
            # Allocate it now: running out of room while writing to the mapping would kill the program.
            os.posix_fallocate(file.fileno(), 0, count)
            return np.memmap(file, dtype, "r+", shape=shape)
    except OSError as error:
        raise InputError(
            f"{shape[0]} frames of {shape[2]} × {shape[1]} pixels take {count / 1e9:.1f} GB, which is much of the "
            f"memory, and there is no temporary file of that size ({error.strerror}): set TMPDIR to a folder with room"
        ) from error


GHOST = FindingKind(
    "ghost",
    "Frames show some of the picture before theirs; it was taken out.",
    "Let the camera wait longer for the projector.",
    ("ghost_share",),
)
LIGHT_SWITCHED = FindingKind(
    "light-switched",
    "The light of the room changed between two frames; it was taken out.",
    "Leave the room's light as it is.",
    ("frames", "light_share"),
)


@dataclass(frozen=True)
class FrameCorrections:
    """The camera's `response`, a `ghost` of the previous picture, and an ambient light change (`switch`); None if
    absent.

    They are corrected in this order, the reverse of that in which they occur.
    """

    response: CameraResponse | None = None
    ghost: Ghost | None = None
    switch: AmbientLightChange | None = None

    def findings(self, plan: SequencePlan) -> Iterator[Finding]:
        """Yield a warning for each effect that was corrected."""
        if self.switch:
            yield Finding(
                LIGHT_SWITCHED,
                Severity.WARNING,
                f"{capitalised(self.switch.description(plan))}, and was taken out.",
                "Better: leave the room's light as it is.",
                {"frames": (self.switch.frame,), "light_share": abs(self.switch.share)},
            )
        if self.ghost:
            yield Finding(
                GHOST,
                Severity.WARNING,
                f"{capitalised(self.ghost.description(plan))}, which was taken out.",
                GHOST.remedy,
                {"ghost_share": self.ghost.share},
            )


@dataclass(frozen=True)
class CorrectedFrames:
    """The frames of a capture as they would be without the effects that are corrected."""

    plan: SequencePlan
    """Of the capture."""
    taken: Image
    """(N, H, W): as kept, in the order in which they were taken."""
    corrections: FrameCorrections = FrameCorrections()
    """What is taken out whenever they are read."""

    def read(self, part: Part = WHOLE, places: Sequence[int] | None = None) -> Iterator[Image]:
        """Yield a part of all frames, or of those at some places."""
        every, ghost, switch = range(len(self.taken)), self.corrections.ghost, self.corrections.switch
        wanted = every if places is None else places
        needed = wanted if ghost is None and switch is None else every
        read = partial(self._without_ghost, part, needed)
        corrected = read() if switch is None else without_change(read, self.plan, switch)
        return (image for place, image in zip(needed, corrected, strict=True) if place in wanted)

    def _without_ghost(self, part: Part, places: Sequence[int]) -> Iterator[Image]:
        response, ghost = self.corrections.response, self.corrections.ghost
        parts = (self.taken[place][part] for place in places)
        light = parts if response is None else map(response.light_of, parts)
        if ghost is None:
            return light
        rows = np.arange(self.taken.shape[1])[part[0]]
        return without_ghost(light, ghost, rows[:, None] if isinstance(part[0], slice) else rows)


def corrections_of(plan: SequencePlan, frames: Image, sample: Sample) -> FrameCorrections:
    """Estimate from a sample what affected all of the kept frames (N, H, W): a nonlinear response, and ghosting."""
    taken, saturation = sample.as_taken, saturation_of(plan, frames)
    lit = unclipped(taken, saturation)
    lit_levels = taken[:, lit]
    top = np.iinfo(np.uint8).max if frames.dtype == np.uint8 else max(frame.max() for frame in _of(plan, frames, []))
    response = camera_response(plan, lit_levels.astype(np.float32), saturation, float(top))
    light = response.light_of(lit_levels) if response else lit_levels
    return FrameCorrections(response, find_ghost(plan, light.astype(np.float32), sample.rows[lit]))


def saturation_of(plan: SequencePlan, frames: Image) -> float:
    """Return the saturation level of the kept frames (N, H, W), of the fringes if there are any."""
    return saturation_level(*_of(plan, frames, plan.fringe_frames))


def _of(plan: SequencePlan, frames: Image, numbers: list[int]) -> list[Image]:
    """Return the frames with these numbers; if there are none white or, without white, all."""
    ends = [] if plan.white is None else [plan.white]
    return [frames[plan.shown.index(number)] for number in numbers or ends or range(len(plan.patterns))]


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
