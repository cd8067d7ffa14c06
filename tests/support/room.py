"""The corner of a room with solids in it, hit by rays; the basis of all scenes of tests.

World: the walls are the planes x = 0, y = 0 and z = 0 (the floor), the room is the positive octant, lengths in metres.
Only the camera model is shared with the code under test.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from filming import Camera, Clip, Played, film, play
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Pose, Size
from calib.numerics import Bools, Floats, Image, Ints
from calib.synthetic import look_at
from hw.settings import SimulatedRigSettings
from hw.simulated import Light, SimulatedRoom
from scanner.patterns import PRESETS, PresetName, write_sequence
from scanner.recordings import Programme, programme_of, write_player_video

SPHERE = 1000
NOTHING = -1
UP = np.array([0.0, 0.0, 1.0])
_EPS = 1e-9


@dataclass(frozen=True)
class Box:
    """A box on or above the floor: `centre` and `size` (3,), rotated by `yaw` (radians) about the vertical."""

    centre: Floats
    size: Floats
    yaw: float = 0.0

    @property
    def axes(self) -> Floats:
        """Unit directions of its edges, (3, 3) columns."""
        return Rotation.from_euler("z", self.yaw).as_matrix()

    def hit(self, origin: Floats, directions: Floats) -> tuple[Floats, Ints]:
        """Where rays enter the box: distance (inf for a miss) and face 0..5 (−x, +x, −y, …)."""
        o, d = (origin - self.centre) @ self.axes, directions @ self.axes
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (-self.size / 2 - o) / d, (self.size / 2 - o) / d
        near, far = np.minimum(one, two), np.maximum(one, two)
        axis = np.argmax(near, axis=1)
        enter, leave = near.max(axis=1), far.min(axis=1)
        side = np.take_along_axis(d, axis[:, None], axis=1)[:, 0] < 0
        return np.where((enter < leave) & (leave > 0), enter, np.inf), (2 * axis + side).astype(np.int32)


@dataclass(frozen=True)
class Ball:
    """A sphere."""

    centre: Floats
    radius: float

    def hit(self, origin: Floats, directions: Floats) -> Floats:
        """Where rays enter the ball: distance, inf for a miss."""
        a = np.sum(directions**2, axis=1)
        b = directions @ (origin - self.centre)
        c = float(np.sum((origin - self.centre) ** 2) - self.radius**2)
        with np.errstate(invalid="ignore"):
            t = (-b - np.sqrt(b * b - a * c)) / a
        return np.where(np.isfinite(t), t, np.inf)


@dataclass(frozen=True)
class Room:
    """`walls`: which of the three walls exist (a box on a table has the floor only); `limit`: their extent (3,)."""

    boxes: tuple[Box, ...] = ()
    ball: Ball | None = None
    walls: tuple[bool, bool, bool] = (True, True, True)
    limit: Floats | None = None

    def cast(self, origin: Floats, directions: Floats) -> tuple[Floats, Ints]:
        """First surface hit by each ray (N, 3): distance in units of the direction, surface id (NOTHING: none).

        Ids: 0, 1, 2 walls; 3 + 6 b + face for box b; SPHERE.
        """
        limit = np.full(3, np.inf) if self.limit is None else self.limit
        depth, surface = np.full(len(directions), np.inf), np.full(len(directions), NOTHING, np.int32)
        for wall in np.flatnonzero(self.walls):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = -origin[wall] / directions[:, wall]
                point = origin + t[:, None] * directions
                closer = (t > _EPS) & (t < depth) & np.all((point > -1e-6) & (point < limit), axis=1)
            depth[closer], surface[closer] = t[closer], wall
        for b, box in enumerate(self.boxes):
            t, face = box.hit(origin, directions)
            closer = (t > _EPS) & (t < depth)
            depth[closer], surface[closer] = t[closer], 3 + 6 * b + face[closer]
        if self.ball is not None:
            t = self.ball.hit(origin, directions)
            closer = (t > _EPS) & (t < depth)
            depth[closer], surface[closer] = t[closer], SPHERE
        return depth, surface

    def lit(self, points: Floats, source: Floats) -> Bools:
        """Whether nothing occludes points (N, 3) from the projector's centre."""
        depth, _ = self.cast(source, points - source)
        return depth > 1 - 1e-6

    def normal(self, surface: int) -> Floats:
        """Unit normal (3,) of a wall or of a face of a box, along an axis, but not always outward."""
        if surface < 3:
            return np.eye(3)[surface]
        box, face = divmod(surface - 3, 6)
        return self.boxes[box].axes[:, face // 2]


@dataclass(frozen=True)
class Placed:
    """A device at `eye` (3,) in the world; `rotation` (3, 3) from the world into its frame."""

    eye: Floats
    rotation: Floats

    @classmethod
    def looking(cls, eye: Floats, target: Floats, roll: float = 0.0) -> "Placed":
        return cls(eye, look_at(eye, target, UP, roll))

    def into(self, target: "Placed") -> Pose:
        """From this device's frame into another's."""
        return Pose(target.rotation @ self.rotation.T, target.rotation @ (self.eye - target.eye))


@dataclass(frozen=True)
class Seen:
    """Ground truth per pixel (N): `camera_px`, `projector_px` (N, 2), `points` (N, 3) in the camera's frame, `surface`,
    and whether it is `lit`. Other values are undefined where nothing is hit.
    """

    camera_px: Floats
    projector_px: Floats
    points: Floats
    surface: Ints
    lit: Bools


def seen(room: Room, calibration: Calibration, camera: Placed) -> Seen:
    """All pixels of the camera, row by row."""
    device, projector = calibration.camera, calibration.projector
    x, y = np.meshgrid(np.arange(device.width, dtype=float), np.arange(device.height, dtype=float))
    camera_px = np.stack([x.ravel(), y.ravel()], axis=1)
    rays = device.unproject(camera_px)
    depth, surface = room.cast(camera.eye, rays @ camera.rotation)
    points = rays * np.where(np.isfinite(depth), depth, 1.0)[:, None]
    projected = projector.project(calibration.pose @ points)
    with np.errstate(invalid="ignore"):
        lit = (surface >= 0) & np.all((projected > 0) & (projected < (projector.width - 1, projector.height - 1)), 1)
    source = calibration.projector_centre @ camera.rotation + camera.eye
    lit[lit] = room.lit(points[lit] @ camera.rotation + camera.eye, source)
    return Seen(camera_px, projected, points, surface, lit)


CAMERA, PROJECTOR = (384, 216), (256, 144)
BIT_RATE = 1.5e6


@cache
def _filmed_room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(furniture=False, interreflection=False), CAMERA, PROJECTOR)


@dataclass
class FilmedRoom:
    """One room, filmed: `folder` receives the video, its sequence.yaml and the recordings; pictures last `hold_s`."""

    folder: Path
    hold_s: float = 0.1
    preset: PresetName = "quick"
    seen: ClassVar[dict[bytes, Light]] = {}

    @property
    def room(self) -> SimulatedRoom:
        return _filmed_room()

    @cached_property
    def programme(self) -> Programme:
        return programme_of(PRESETS[self.preset].patterns(PROJECTOR), Size(*PROJECTOR), self.hold_s, 1)

    @cached_property
    def sequence(self) -> Path:
        write_sequence(self.folder, self.programme.patterns, PROJECTOR, video=self.programme.as_dict("video.mp4"))
        return self.folder / "sequence.yaml"

    @cached_property
    def played(self) -> Played:
        path = self.folder / "video.mp4"
        write_player_video(path, self.programme)
        return play(path)

    def light_of(self, picture: Image) -> Light:
        key = picture.tobytes()
        if key not in self.seen:
            full_well = np.float32(self.room.settings.full_well_electrons)
            self.seen[key] = self.room.electrons(picture) / full_well
        return self.seen[key]

    def film(self, name: str, camera: Camera, start_s: float = 0.7, length_s: float | None = None) -> Path:
        path = self.folder / name
        clip = Clip(start_s, length_s or self.played.length_s - start_s)
        film(path, self.played, self.light_of, camera, clip)
        return path
