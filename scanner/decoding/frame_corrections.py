"""Effects on all frames of a capture that are corrected before decoding."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from calib.numerics import Image
from scanner.decoding.ambient_light_change import AmbientLightChange, without_change
from scanner.decoding.arrays import WHOLE, Part
from scanner.decoding.light.camera_response import CameraResponse
from scanner.decoding.light.ghost import Ghost, without_ghost
from scanner.decoding.sequence_plan import SequencePlan


@dataclass(frozen=True)
class FrameCorrections:
    """The camera's `response`, a `ghost` of the previous picture, and an ambient light change (`switch`); None if
    absent.

    They are corrected in this order, the reverse of that in which they occur.
    """

    response: CameraResponse | None = None
    ghost: Ghost | None = None
    switch: AmbientLightChange | None = None

    @property
    def is_plain(self) -> bool:
        """Whether the frames need no correction."""
        return self == FrameCorrections()

    def undone(self, frames: Image, plan: SequencePlan, part: Part = WHOLE) -> Iterator[Image]:
        """Yield a part of the corrected frames of a capture, from the kept frames (N, H, W)."""
        read = partial(self._steady, frames, part)
        return read() if self.switch is None else without_change(read, plan, self.switch)

    def remarks(self, plan: SequencePlan) -> Iterator[str]:
        """Yield sentences for the operator."""
        if self.ghost:
            yield f"{self.ghost.description(plan)}, which was taken out. Let the camera wait longer for the projector."
        if self.switch:
            yield f"{self.switch.description(plan)}, and was taken out. Better: leave the room's light as it is."

    def _steady(self, frames: Image, part: Part) -> Iterator[Image]:
        # A ghost depends on the row, and on what is clipped anywhere in the frame.
        seen = frames[:, *part] if self.ghost is None else frames
        light = iter(seen) if self.response is None else map(self.response.light_of, seen)
        return light if self.ghost is None else (image[part] for image in without_ghost(light, self.ghost))
