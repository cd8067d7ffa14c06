"""The frames of a capture, read as they would be without the effects on whole frames that are corrected."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Protocol

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import TRIAL_PIXELS, WHOLE, Image, Part, Window, evenly_spread
from scanner.decoding.corrections.camera_response import FULL_SCALE, CameraResponse, camera_response
from scanner.decoding.corrections.gains import FrameGains, fit_bits, gains_of_pairs, with_white_as_in_patterns
from scanner.decoding.corrections.ghost import Ghost, find_ghost
from scanner.decoding.frame_stack import FrameStack
from scanner.decoding.light import (
    AmbientLightChange,
    ConstraintSet,
    PartOfFrames,
    Samples,
    check_frames,
    is_suspected,
    lit_by,
    measure_noise,
    unclipped,
)
from scanner.decoding.sequence_plan import SequencePlan
from scanner.errors import InputError
from scanner.shown_text import capitalised

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


class Correction(Protocol):
    """An effect on whole frames."""

    def apply(self, frames: PartOfFrames, places: Sequence[int]) -> Iterator[Image]:
        """Yield the pixels (...) in the frames at some places, in ascending order, without it."""


@dataclass(frozen=True)
class FrameCorrections:
    """The camera's `response`, a `ghost` of the previous picture, an ambient light change (`switch`), and the `gains`
    of frames of different brightness; None if absent.

    They are corrected in this order, the reverse of that in which they occur.
    """

    response: CameraResponse | None = None
    ghost: Ghost | None = None
    switch: AmbientLightChange | None = None
    gains: FrameGains | None = None

    @property
    def in_order(self) -> tuple[Correction, ...]:
        """Those that there are, in the order in which they are applied."""
        every = self.response, self.ghost, self.switch, self.gains
        return tuple(correction for correction in every if correction is not None)

    def change(self, frames: Collection[int]) -> bool:
        """Whether any of some frames, by number, is corrected."""
        changed = {frame for group in self.gains.harmful for frame in group} if self.gains else set()
        return any((self.response, self.ghost, self.switch)) or not changed.isdisjoint(frames)

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
        rows = np.arange(self.taken.shape[1])[part[0]]
        rows = rows[:, None] if isinstance(part[0], slice) else rows

        def read(chosen: Sequence[int]) -> Iterator[Image]:
            return (self.taken[place][part] for place in chosen)

        frames = PartOfFrames(self.plan, rows, read)
        for correction in self.corrections.in_order:
            frames = replace(frames, read=partial(correction.apply, frames))
        return frames.read(range(len(self.taken)) if places is None else places)

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the frames, as long as no gains are taken out of fringes."""
        return next(self.read((slice(0, 1), slice(0, 1)), [0])).dtype

    def by_number(self, part: Part = WHOLE, numbers: Collection[int] | None = None) -> Iterator[tuple[int, Image]]:
        """Yield the number of each frame, or of some, and a part of it, in the order in which they were first taken."""
        places = self._places(numbers)
        yield from zip(places, self.read(part, [*places.values()]), strict=True)

    def stacked(self, part: Window, numbers: Collection[int]) -> tuple[Image, dict[int, int], tuple[int, int]]:
        """Return a stack (N, ...) that holds some frames, by number; the place of each in it; and the row and column at
        which a part begins in it.

        The frames as they were kept, if they are not corrected.
        """
        places = self._places(numbers)
        if not self.corrections.change(numbers):
            return self.taken, places, (part[0].start, part[1].start)
        # Fringes that were equalised are no whole grey levels any more.
        kinds = {frame.dtype for _, frame in self.by_number((slice(0, 1), slice(0, 1)), numbers)}
        stack = np.empty((len(places), *self.taken[0][part].shape), np.result_type(np.uint8, *kinds))
        for into, (_, frame) in zip(stack, self.by_number(part, numbers), strict=True):
            into[:] = frame
        return stack, {number: place for place, number in enumerate(places)}, (0, 0)

    def with_gains(self, gains: FrameGains) -> "CorrectedFrames":
        """Return the frames with other gains taken out."""
        return replace(self, corrections=replace(self.corrections, gains=gains))

    def sampled(self, taken: Samples) -> Samples:
        """Return samples of the frames, given those of the frames as they were taken."""
        return Samples.read(self.plan, self.taken.shape[1:], self.read) if self.corrections.in_order else taken

    def _places(self, numbers: Collection[int] | None) -> dict[int, int]:
        """Return the place at which each frame, or each of some, was first taken, by number, in ascending order."""
        return {number: place for number, place in self._first.items() if numbers is None or number in numbers}

    @cached_property
    def _first(self) -> dict[int, int]:
        """The place at which each frame was first taken, by number, in ascending order."""
        return {number: self.plan.shown.index(number) for number in dict.fromkeys(self.plan.shown)}


def estimate_corrections(stack: FrameStack) -> FrameCorrections:
    """Estimate from the samples what affected all frames: a nonlinear response, ghosting, and a harmful change of the
    ambient light; nothing if the frames are merged from several exposures.

    A ghost and a change of the light leave the same sums uneven: where there is a ghost, no change is looked for.
    """
    if stack.is_merged:
        return FrameCorrections()
    plan, sample = stack.plan, stack.samples.scattered
    taken, saturation = sample.as_taken, stack.saturation
    lit = unclipped(taken, saturation)
    lit_levels = taken[:, lit]
    top = np.iinfo(np.uint8).max if taken.dtype == np.uint8 else max(frame.max() for frame in stack.showing([]))
    response = camera_response(plan, lit_levels.astype(np.float32), saturation, float(top))
    light = (response.light_of(lit_levels) if response else lit_levels).astype(np.float32)
    corrections = FrameCorrections(response, find_ghost(plan, light, sample.rows[lit]))
    some = evenly_spread(light, TRIAL_PIXELS, axis=-1)
    if corrections.ghost or not some.size or not is_suspected(ConstraintSet(plan), some):
        return corrections
    return replace(corrections, switch=_ambient_change(stack, corrections))


def _ambient_change(stack: FrameStack, corrections: FrameCorrections) -> AmbientLightChange | None:
    """Return the ambient light change that explains the frames best; None if it does no harm, or if the frames without
    it fail the checks of the sample: then it is something else.
    """
    try:
        switch = _check_sample(stack, corrections)
        if switch is None or not switch.is_harmful:
            return None
        _check_sample(stack, replace(corrections, switch=switch))
    except InputError:
        return None  # decoding meets it again, with all that is known by then
    return switch


def _check_sample(stack: FrameStack, corrections: FrameCorrections) -> AmbientLightChange | None:
    """Check the frames as corrected on samples of them, once equally bright; return the ambient light change that the
    checks find. Raises InputError.
    """
    plan, samples = stack.plan, CorrectedFrames(stack.plan, stack.frames, corrections).sampled(stack.samples)
    saturation = float(FULL_SCALE) if corrections.response else stack.saturation
    of_pairs, (_, white_gain) = gains_of_pairs(plan, samples.scattered), fit_bits(plan, samples.scattered)
    samples = with_white_as_in_patterns(plan, samples, white_gain)
    levels = samples.scattered.levels
    gains = FrameGains(of_pairs).with_fringes(plan, samples.scattered, lit_by(np.ptp(levels, axis=0)))
    sample = gains.without(plan, samples).scattered
    noise = measure_noise(plan, sample, saturation)
    return check_frames(plan, levels, sample.levels, noise, saturation)[1]
