"""The frames of a capture, kept as they were taken: in memory, in a memory-mapped file if they are large, or refused.

A frame that is the one before, bit for bit, comes from a projector that was late, or a camera that gave a picture
twice: noise makes each picture another one. It does not show its pattern, and no comparison of it means anything: a
fine bit looks unresolved, a coarse one exchanged. It is left out, and mostly its inverse or the other steps of its
fringe tell what it would have shown.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from tempfile import TemporaryFile
from typing import Any

import cv2
import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats32, Image
from scanner.decoding.light.constraints import NoiseModel, measure_noise
from scanner.decoding.light.exposures import ExposureMerger, exposures_of, saturation_level
from scanner.decoding.light.samples import Samples
from scanner.decoding.planning import plan_sequence, usable
from scanner.decoding.sequence_plan import SequencePlan
from scanner.errors import FramesError, InputError
from scanner.io import require_memory, total_bytes
from scanner.patterns import Pattern
from scanner.shown_text import capitalised

# Share of the machine's memory above which frames are mapped from a file.
_MOST_OF_MEMORY = 0.25
# Peak use, with 16-bit frames and a match at every pixel; with codes only, edges and all pairs are kept as well.
_BYTES_PER_PIXEL, _OF_CODES_ALONE = 70, 136
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


@dataclass(frozen=True)
class FrameStack:
    """The frames of a whole capture."""

    plan: SequencePlan
    """Of the frames."""
    frames: Image
    """(N, H, W): grey, in the order in which they were taken."""
    samples: Samples
    """Of the frames."""
    texture: Image
    """The fully lit scene, (H, W) or (H, W, 3), as the camera gave it, at the shortest exposure."""
    is_merged: bool = False
    """Whether each frame is merged from several exposures, each of which has its own response and ghost."""
    log_exposure: Floats32 | None = None
    """(H, W): logarithm of each pixel's exposure relative to the shortest; None if all were exposed alike."""
    finding: Finding | None = None
    """About frames that were left out; None if none was."""

    @cached_property
    def saturation(self) -> float:
        """The saturation level of the fringes, or without fringes of white, or without white of all frames."""
        return saturation_level(*self.showing(self.plan.fringe_frames))

    @property
    def noise(self) -> NoiseModel:
        """That of a pixel of the frames as they were taken."""
        return measure_noise(self.plan, self.samples.scattered, self.saturation)

    def without_frames(self) -> "FrameStack":
        """Return what is left to tell of the capture once its frames are decoded."""
        return replace(self, frames=np.empty((0, *self.frames.shape[1:]), self.frames.dtype))

    def showing(self, numbers: Sequence[int]) -> list[Image]:
        """Return the frames (H, W) with these numbers; if there are none white or, without white, all."""
        ends = [] if self.plan.white is None else [self.plan.white]
        return [
            self.frames[self.plan.shown.index(number)] for number in numbers or ends or range(len(self.plan.patterns))
        ]


class FrameCollector:
    """Take the frames of a known sequence one by one.

    If every pattern is repeated equally often in a row, the repeats are exposures to be merged, white first. Raises
    InputError if the patterns do not determine both coordinates of a projector of (width, height) pixels, or one if a
    `calibrated` rig tells the other.
    """

    def __init__(self, patterns: Sequence[Pattern], projector_size: tuple[int, int], *, calibrated: bool) -> None:
        once, repeats = exposures_of(patterns)
        self._projector_size, self._calibrated = projector_size, calibrated
        self.plan = replace(plan_sequence(once, projector_size, calibrated=calibrated), repeats=repeats)
        self._merger = ExposureMerger(once, repeats) if repeats > 1 else None
        self._count = 0
        self._copies: list[int] = []
        self._frames: Image | None = None
        self._samples: Samples | None = None
        self._texture: Image | None = None
        self._has_white = False

    def add(self, image: Image, exposure_us: float | None = None) -> None:
        """Keep the next frame, as `Decoder.add` says."""
        self._check_form(image)
        merged = image
        if self._merger is not None:
            complete = self._merger.add(self.plan.name(self.plan.shown[self._count]), image, exposure_us)
            if complete is None:
                return
            merged = complete
        self._keep(merged)

    def complete(self) -> FrameStack:
        """Return the frames, once. Raises InputError if frames are missing, or if late ones leave too little."""
        plan, frames, samples = self.plan, self._frames, self._samples
        if self._count < len(plan.shown):
            raise InputError(
                f"the sequence has {plan.frame_count} frames, found {plan.repeats * self._count}; the first that is "
                f"missing: {plan.name(plan.shown[self._count])}"
            )
        if frames is None or samples is None or self._texture is None:
            raise RuntimeError("the frames were taken already")
        self._frames = None
        if self._merger is not None:
            texture = self._merger.to_shortest_exposure(self._texture)
            return FrameStack(plan, frames, samples, texture, is_merged=True, log_exposure=self._merger.log_exposure)
        return self._without_late(FrameStack(plan, frames, samples, self._texture))

    def _check_form(self, image: Image) -> None:
        if self._count == len(self.plan.shown):
            raise InputError(f"the sequence has {self.plan.frame_count} frames, found one more")
        name = self.plan.name(self.plan.shown[self._count])
        if (
            image.ndim not in (2, 3)
            or (image.ndim == 3 and image.shape[2] != 3)
            or image.dtype not in (np.uint8, np.uint16)
        ):
            raise InputError(
                f"{name}: expected a grey or BGR image of 8 or 16 bits, found shape {image.shape} of {image.dtype}"
            )
        if self._texture is not None and (image.shape, image.dtype) != (self._texture.shape, self._texture.dtype):
            raise InputError(
                f"{name}: expected an image like those before it, {_form(self._texture)}, found {_form(image)}"
            )

    def _keep(self, image: Image) -> None:
        """Store the next frame, and sample it."""
        if self._frames is None or self._samples is None:
            self._frames = room_for_frames(len(self.plan.shown), image, codes_alone=not self.plan.fringes)
            shape = image.shape[0], image.shape[1]
            self._samples = Samples.of(self.plan, shape)
        place, kept = self._count, self._frames[self._count]
        if image.ndim == 3:
            cv2.cvtColor(image, cv2.COLOR_BGR2GRAY, dst=kept)
        else:
            np.copyto(kept, image)
        if self._merger is None and place and is_copy(kept, self._frames[place - 1]):
            self._copies.append(place)
        self._samples.add(self.plan, place, kept)
        # The white frame, or without one the maximum of all frames.
        is_white = self.plan.shown[place] == self.plan.white and place not in self._copies
        if self._texture is None or is_white:
            self._texture, self._has_white = image.copy(), is_white
        elif not self._has_white:
            cv2.max(self._texture, image, dst=self._texture)
        self._count += 1

    def _without_late(self, stack: FrameStack) -> FrameStack:
        """Return the stack without its late frames, and with the plan of the others."""
        late = _late_places(stack, self._copies)
        if not late:
            return stack
        decoded_as, finding = _patterns_without(stack.plan, late, self._projector_size, calibrated=self._calibrated)
        places = [place for place, pattern in enumerate(decoded_as) if pattern is not None]
        for number, place in enumerate(places):
            if place > number:
                stack.frames[number] = stack.frames[place]
        frames, patterns = stack.frames[: len(places)], [pattern for pattern in decoded_as if pattern is not None]
        plan = plan_sequence(patterns, self._projector_size, calibrated=self._calibrated)
        samples = Samples.read(plan, frames.shape[1:], lambda part: (frame[part] for frame in frames))
        return replace(stack, plan=plan, frames=frames, samples=samples, finding=finding)


def _form(image: Image) -> str:
    colour = "BGR" if image.ndim == 3 else "grey"
    return f"{image.shape[1]} × {image.shape[0]} {colour}, {8 * image.itemsize} bits"


def room_for_frames(count: int, first: Image, *, codes_alone: bool) -> Image:
    """Return an array (N, H, W) for as many frames like the first.

    A frame is a view that keeps all of them in memory. Raises InputError if there is not enough memory to decode them,
    or not enough room for the file.
    """
    shape = first.shape[0], first.shape[1]
    needed, memory = count * shape[0] * shape[1] * first.itemsize, total_bytes()
    is_mapped = memory is not None and needed > _MOST_OF_MEMORY * memory
    require_decoding_memory(shape, 0 if is_mapped else needed, codes_alone=codes_alone)
    return _mapped((count, *shape), first.dtype) if is_mapped else np.empty((count, *shape), first.dtype)


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


def describe_copies(names: str, count: int) -> str:
    """What frames of these names are that are the ones before them, and why."""
    same = "is the frame before it" if count == 1 else "are the frames before them"
    return f"{names} {same}, bit for bit: the projector was late, or the camera gave a picture twice"


def is_copy(frame: Image, previous: Image) -> bool:
    """Whether two frames (H, W) are the same, bit for bit."""
    return np.array_equal(frame[::_ROWS], previous[::_ROWS]) and np.array_equal(frame, previous)


def _late_places(stack: FrameStack, copies: Sequence[int]) -> list[int]:
    """Return those of the `copies` (places of frames) that should show another pattern than the frame before.

    None if there is no noise, without which patterns that differ elsewhere may look the same.
    """
    late = [place for place in copies if stack.plan.shown[place] != stack.plan.shown[place - 1]]
    if not late:
        return []
    brightest = stack.samples.scattered.levels.max(axis=0)
    return late if float(np.median(stack.noise.sigma(brightest))) > _LEAST_NOISE else []


def _patterns_without(
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
