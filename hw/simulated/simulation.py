"""A simulated room, which can be lit with pictures and viewed; and its ground truth, for tests and for the summary.

The simulated devices do not reveal the truth.
"""

import copy
from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import Calibration, Intrinsics, Pose
from calib.numerics import Floats, Image, Ints
from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Light
from hw.simulated.device import Optics, PlacedDevice
from hw.simulated.illumination import ProjectorLight
from hw.simulated.motion import box_in, offset_px, person_in, turned
from hw.simulated.picture import build_sensor
from hw.simulated.placement import resized
from hw.simulated.renderer import Renderer, build_renderer, has_indirect_light
from hw.simulated.room import DRAWN_BY, DrawnRoom, draw_room

# Stream of random numbers for paint and rays; `draw_room` uses streams from 0.
_RENDERING_STREAM = 100
# Settings that determine the transport of light: another value of one needs another room.
_ROOM_SETTINGS = (*DRAWN_BY, "pose", "projector_pose", "albedo", "wallpaper", "interreflection")


@dataclass(frozen=True)
class GroundTruth:
    """Ground truth at the centre of each camera pixel."""

    projector_px: Floats
    """The projector pixel that lights it directly; NaN in shadow and outside the picture, (H, W, 2)."""
    points_m: Floats
    """The surface point in the camera's frame, (H, W, 3)."""
    label: Ints
    """The `Label` of the surface, (H, W)."""
    direct_share: Floats
    """Direct light over all light of a white picture, (H, W)."""


def true_calibration(room: DrawnRoom, homography: Floats | None = None) -> Calibration | None:
    """The calibration of a room's rig, in metres; None if no pinhole projector gives the picture.

    `homography` (3, 3): from the picture's pixels to those of the projector's panel.
    """
    projector = _intrinsics(room.projector.optics)
    if homography is not None:
        reshaped = _reshaped(projector, homography)
        if reshaped is None:
            return None
        projector = reshaped
    return replace(calibration_between(room.camera, room.projector), projector=projector)


def calibration_between(camera: PlacedDevice, projector: PlacedDevice) -> Calibration:
    """The calibration of two devices, in metres."""
    pose = projector.pose.inverse() @ camera.pose
    return Calibration(_intrinsics(camera.optics), _intrinsics(projector.optics), pose, unit="m")


def _reshaped(panel: Intrinsics, homography: Floats) -> Intrinsics | None:
    """Intrinsics of a projector whose picture is scaled; None if it is mirrored or no longer a rectangle."""
    (a, b, x), (c, d, y), (e, f, g) = homography.tolist()
    if max(map(abs, (b, c, e, f))) > _RECTANGULAR or a <= 0 or d <= 0:
        return None
    (fx, fy), (x0, y0) = panel.focal_px, panel.principal_point_px
    return replace(panel, focal_px=(g * fx / a, g * fy / d), principal_point_px=((g * x0 - x) / a, (g * y0 - y) / d))


def true_view(room: DrawnRoom, renderer: Renderer) -> GroundTruth:
    """Ground truth of every camera pixel, by a ray through its centre."""
    optics = room.camera.optics
    x, y = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
    directions = room.camera.rays(np.stack([x.ravel(), y.ravel()]))
    t, surface = room.scene.cast(room.camera.centre[:, None], directions)
    along = t * directions
    points = room.camera.centre[:, None] + along
    pixels, irradiance = ProjectorLight(room.scene, room.projector).direct(surface, points)
    picture = renderer.picture.to_picture(pixels)
    projector = room.projector.optics
    lit = (irradiance > 0) & projector.sees(pixels) & projector.sees(picture)

    light = np.ones((renderer.picture.height, renderer.picture.width), np.float32)
    direct = renderer.direct(light).astype(np.float64)
    shape = (optics.height, optics.width)
    return GroundTruth(
        np.where(lit, picture, np.nan).T.reshape(*shape, 2),
        (room.camera.rotation @ along).T.reshape(*shape, 3),
        room.scene.labels[surface].reshape(shape),
        direct / (direct + renderer.indirect(light) + renderer.ambient),
    )


def _intrinsics(optics: Optics) -> Intrinsics:
    return Intrinsics(
        optics.width,
        optics.height,
        (optics.focal_px, optics.focal_px),
        optics.principal_point_px,
        (optics.k1, optics.k2, 0.0, 0.0, 0.0),
    )


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


_RECTANGULAR = 1e-9  # rounding error of entries that are zero
