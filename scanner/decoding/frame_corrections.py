"""Effects on all frames of a capture that are corrected before decoding."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import WHOLE, Image, Part
from scanner.decoding.ambient_light_change import AmbientLightChange, without_change
from scanner.decoding.light.camera_response import CameraResponse, camera_response
from scanner.decoding.light.ghost import Ghost, find_ghost, without_ghost
from scanner.decoding.light.lit_pixels import saturation_level, unclipped
from scanner.decoding.samples import Sample
from scanner.decoding.sequence_plan import SequencePlan
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


@dataclass(frozen=True)
class FrameCorrections:
    """The camera's `response`, a `ghost` of the previous picture, and an ambient light change (`switch`); None if
    absent.

    They are corrected in this order, the reverse of that in which they occur.
    """

    response: CameraResponse | None = None
    ghost: Ghost | None = None
    switch: AmbientLightChange | None = None

    def undone(
        self, frames: Image, plan: SequencePlan, part: Part = WHOLE, places: Sequence[int] | None = None
    ) -> Iterator[Image]:
        """Yield a part of the corrected frames of a capture, from the kept frames (N, H, W): of all, or of those at
        some places.
        """
        every = range(len(frames))
        wanted = every if places is None else places
        needed = wanted if self.ghost is None and self.switch is None else every
        read = partial(self._steady, frames, part, needed)
        corrected = read() if self.switch is None else without_change(read, plan, self.switch)
        return (image for place, image in zip(needed, corrected, strict=True) if place in wanted)

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

    def _steady(self, frames: Image, part: Part, places: Sequence[int]) -> Iterator[Image]:
        parts = (frames[place][part] for place in places)
        light = parts if self.response is None else map(self.response.light_of, parts)
        if self.ghost is None:
            return light
        rows = np.arange(frames.shape[1])[part[0]]
        return without_ghost(light, self.ghost, rows[:, None] if isinstance(part[0], slice) else rows)


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
