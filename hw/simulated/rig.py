"""The two devices in a simulated room."""

import numpy as np

from calib.arrays import Image
from hw.rig import Frame
from hw.simulated.arrays import Light
from hw.simulated.simulation import SimulatedRoom

# Random numbers of the camera's noise; the room's have other streams.
_NOISE_STREAM = 101


class SimulatedProjector:
    """Lights the room with what it is shown; black at first."""

    def __init__(self, room: SimulatedRoom) -> None:
        self._room = room
        width, height = self.size
        self._electrons = room.electrons(np.zeros((height, width), np.uint8))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        optics = self._room.room.projector.optics
        return optics.width, optics.height

    @property
    def electrons_in_camera(self) -> Light:
        """What the room sends to the camera's pixels now."""
        return self._electrons

    def show(self, image: Image) -> None:
        """Light the room with an (H, W) 8-bit grey image. Raises ValueError if it has another size or type."""
        width, height = self.size
        if image.shape != (height, width) or image.dtype != np.uint8:
            raise ValueError(
                f"the projector shows 8-bit grey images of {width} × {height} pixels, "
                f"found {image.dtype} of the shape {image.shape}"
            )
        self._electrons = self._room.electrons(image)


class SimulatedCamera:
    """Sees the room as the projector lights it now; every frame has noise of its own."""

    def __init__(self, room: SimulatedRoom, projector: SimulatedProjector) -> None:
        self._room = room
        self._projector = projector
        self._noise = np.random.default_rng([room.settings.seed, _NOISE_STREAM, room.settings.pose])
        self._exposure_us = room.sensor.exposure_us

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        optics = self._room.room.camera.optics
        return optics.width, optics.height

    def expose_for(self, exposure_us: float) -> None:
        """Expose all frames from now on so long."""
        self._exposure_us = exposure_us

    def grab(self) -> Frame:
        """One frame of what the projector shows now."""
        sensor = self._room.sensor
        electrons = self._projector.electrons_in_camera * np.float32(self._exposure_us / sensor.exposure_us)
        return Frame(sensor.read(electrons, self._noise), exposure_us=self._exposure_us)
