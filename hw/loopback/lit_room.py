"""A simulated room that several projectors light, as one camera sees it."""

from collections.abc import Sequence

from calib.numerics import Image
from hw.loopback.settings import LoopbackSettings
from hw.simulated.arrays import Light
from hw.simulated.simulation import SimulatedRoom


class LitRoom:
    """The room of a loopback camera, with a projector for each screen of these sizes, (width, height) in pixels.

    `brightest`: the room as the brightest projector alone lights it. The camera's sensor is set for that one.
    """

    def __init__(self, settings: LoopbackSettings, screens: Sequence[tuple[int, int]]) -> None:
        poses = settings.projector_poses or (settings.room.projector_pose,)
        self._rooms = [
            SimulatedRoom(settings.room.model_copy(update={"projector_pose": pose}), settings.camera_size, size)
            for pose, size in zip(poses, screens, strict=True)
        ]
        self.brightest = min(self._rooms, key=lambda room: room.sensor.exposure_us)

    def electrons(self, number: int, picture: Image) -> Light:
        """Expected electrons (H, W) while the projector of that number shows an 8-bit picture; those of all projectors
        add up. The first projector's are with the ambient light.
        """
        renderer = self._rooms[number].renderer
        light = renderer.projected(renderer.picture.linear(picture))
        return self.brightest.sensor.electrons(light if number else light + renderer.ambient)
