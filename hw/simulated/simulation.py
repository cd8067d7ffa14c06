"""A simulated room, ready to be lit with pictures and looked at."""

from dataclasses import replace

import numpy as np

from calib.geometry import Calibration
from calib.numerics import Image
from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Light
from hw.simulated.device import PlacedDevice
from hw.simulated.placement import resized
from hw.simulated.renderer import build_renderer
from hw.simulated.room import Room, draw_room
from hw.simulated.sensor import build_sensor
from hw.simulated.truth import GroundTruth, true_calibration, true_view

# A stream of random numbers for paint and rays, apart from those of `draw_room`, which are numbered from 0.
_RENDERING_STREAM = 100


class SimulatedRoom:
    """A room with a camera and a projector of given sizes, (width, height) in pixels.

    Construction takes seconds: it finds out once where all light goes.
    """

    def __init__(
        self, settings: SimulatedRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
    ) -> None:
        self.settings = settings
        self.room = place_room(settings, camera_size, projector_size)
        self.renderer = build_renderer(self.room, settings, np.random.default_rng([settings.seed, _RENDERING_STREAM]))
        white = np.full((projector_size[1], projector_size[0]), 255, np.uint8)
        self.sensor = build_sensor(settings, self.renderer.render(white))

    def electrons(self, picture: Image) -> Light:
        """Expected electrons (H, W) of the camera's pixels while the projector shows an 8-bit picture."""
        return self.sensor.electrons(self.renderer.render(picture))

    @property
    def calibration(self) -> Calibration:
        """The true calibration, in metres."""
        return true_calibration(self.room)

    def ground_truth(self) -> GroundTruth:
        """What is true of each camera pixel."""
        return true_view(self.room, self.renderer)


def place_room(settings: SimulatedRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]) -> Room:
    """The room of a seed, seen and lit by devices of given sizes, (width, height) in pixels."""
    drawn = draw_room(settings)
    return Room(drawn.scene, _resized(drawn.camera, camera_size), _resized(drawn.projector, projector_size))


def _resized(device: PlacedDevice, size: tuple[int, int]) -> PlacedDevice:
    return replace(device, optics=resized(device.optics, *size))
