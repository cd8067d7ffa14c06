"""A simulated room: it can be lit with pictures and viewed."""

import copy
from dataclasses import replace

import numpy as np

from calib.geometry import Calibration, Pose
from calib.numerics import Image
from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Light
from hw.simulated.device import PlacedDevice
from hw.simulated.motion import box_in, offset_px, person_in, turned
from hw.simulated.placement import resized
from hw.simulated.renderer import Renderer, build_renderer, has_indirect_light
from hw.simulated.room import DRAWN_BY, DrawnRoom, draw_room
from hw.simulated.sensor import build_sensor
from hw.simulated.truth import GroundTruth, true_calibration, true_view

# Stream of random numbers for paint and rays; `draw_room` uses streams from 0.
_RENDERING_STREAM = 100
# Settings that determine the transport of light: another value of one needs another room.
_ROOM_SETTINGS = (*DRAWN_BY, "pose", "projector_pose", "albedo", "wallpaper", "interreflection")


class SimulatedRoom:
    """A room with a camera and a projector of given sizes, (width, height) in pixels.

    Construction takes seconds, because it solves the transport of indirect light, unless the settings have none. `room`
    and `renderer` are those of frame 0.
    """

    def __init__(
        self, settings: SimulatedRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
    ) -> None:
        self.settings = settings
        self.room = place_room(settings, camera_size, projector_size)
        self.renderer = build_renderer(self.room, settings, np.random.default_rng([settings.seed, _RENDERING_STREAM]))
        self._begin()

    def under(self, **settings: object) -> "SimulatedRoom":
        """The same room with other settings of its light, lenses, sensor and motion, in a short time.

        Raises ValueError for settings that need another room.
        """
        copied = copy.copy(self)
        copied.settings = SimulatedRigSettings.model_validate(self.settings.model_dump() | settings)
        fixed = [key for key in _ROOM_SETTINGS if getattr(copied.settings, key) != getattr(self.settings, key)]
        if has_indirect_light(copied.settings) and not self.renderer.ceiling.any():
            fixed.append("ambient")
        if fixed:
            raise ValueError(f"{', '.join(fixed)}: another value needs another room")
        picture = self.renderer.picture.under(copied.settings)
        copied.renderer = replace(self.renderer, picture=picture, ambient_level=copied.settings.ambient)
        if copied.settings.board != self.settings.board:
            copied.renderer = copied.renderer.with_board(copied.settings)
        copied._begin()
        return copied

    def _begin(self) -> None:
        optics = self.room.projector.optics
        self.sensor = build_sensor(
            self.settings, self.renderer.render(np.full((optics.height, optics.width), 255, np.uint8))
        )
        self._last: tuple[tuple[float, ...], Renderer] | None = None

    def at(self, frame: int) -> Renderer:
        """The view in a frame, counted from 0. It is `renderer` unless something has moved."""
        bump, drift = self.settings.bump, self.settings.drift
        camera, projector = (offset_px(name, bump, drift, frame) for name in ("camera", "projector"))
        placed = turned(self.room.camera, camera)
        bodies = person_in(frame, self.settings.passer, placed), box_in(frame, self.settings.pushed, placed)
        blocks = [body for body in bodies if body is not None]
        if not blocks and not any((*camera, *projector)):
            return self.renderer
        moved = (*camera, *projector, *(number for block in blocks for number in block.origin))
        if self._last is None or self._last[0] != moved:
            self._last = moved, self.renderer.moved(placed, turned(self.room.projector, projector), *blocks)
        return self._last[1]

    def ambient_level(self, frame: int) -> float:
        """Ambient light in a frame, relative to the projector's white."""
        light = self.settings.light
        return self.settings.ambient if light.ambient is None or frame < light.frame else light.ambient

    def electrons(self, picture: Image) -> Light:
        """Expected electrons (H, W) of the camera's pixels in frame 0, while the projector shows an 8-bit picture."""
        return self.sensor.electrons(self.renderer.render(picture))

    @property
    def calibration(self) -> Calibration | None:
        """The true calibration in frame 0, in metres; None if no pinhole projector gives the picture."""
        return true_calibration(self.room, self.renderer.picture.homography)

    @property
    def place(self) -> Pose:
        """The pose of the rig in frame 0: X_world = R X_camera + t, in metres."""
        return self.room.camera.pose

    def ground_truth(self) -> GroundTruth:
        """Ground truth of each camera pixel in frame 0."""
        return true_view(self.room, self.renderer)


def place_room(
    settings: SimulatedRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> DrawnRoom:
    """The room of a seed with devices of given sizes, (width, height) in pixels."""
    drawn = draw_room(settings)
    return DrawnRoom(drawn.scene, _resized(drawn.camera, camera_size), _resized(drawn.projector, projector_size))


def _resized(device: PlacedDevice, size: tuple[int, int]) -> PlacedDevice:
    return replace(device, optics=resized(device.optics, *size))
