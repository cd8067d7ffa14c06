"""What happened to all frames of a capture on their way, undone in one place before they are decoded."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from calib.numerics import Image
from scanner.decoding.ambient_light_change import AmbientLightChange, without_light
from scanner.decoding.light.camera_response import CameraResponse
from scanner.decoding.light.ghost import Ghost, without_ghost
from scanner.decoding.sequence_plan import SequencePlan


@dataclass(frozen=True)
class Reading:
    """The camera's `response`, a `ghost` of the picture before, and light that was switched; None where there was none.

    They are undone in this order, the last that happened first.
    """

    response: CameraResponse | None = None
    ghost: Ghost | None = None
    switch: AmbientLightChange | None = None

    @property
    def is_plain(self) -> bool:
        """Whether frames are read as they were taken."""
        return self == Reading()

    def undone(self, frames: Image, plan: SequencePlan) -> Iterator[Image]:
        """The kept frames (N, H, W) of a capture, one by one, as they would be without all of it."""
        light = None if self.switch is None else self.switch.image(self._steady(frames), frames.shape[1:], plan)
        read = self._steady(frames)
        return read if light is None or self.switch is None else without_light(read, light, plan, self.switch)

    def remarks(self, plan: SequencePlan) -> Iterator[str]:
        """For the operator."""
        if self.ghost:
            yield f"{self.ghost.description(plan)}, which was taken out. Let the camera wait longer for the projector."
        if self.switch:
            yield f"{self.switch.said(plan)}, and was taken out. Better: leave the room's light as it is."

    def _steady(self, frames: Iterable[Image]) -> Iterator[Image]:
        light = iter(frames) if self.response is None else map(self.response.light_of, frames)
        return light if self.ghost is None else without_ghost(light, self.ghost)
