"""A simulated thing in front of a rig, the counterpart of `SimulatedRoom`: it can be lit with pictures and viewed."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy import sparse

from calib.geometry import Calibration, Pose
from calib.numerics import Bools, Floats
from hw.settings import SimulatedRigSettings, ThingSettings
from hw.simulated.arrays import Light, sparse_matrix
from hw.simulated.device import Optics, PlacedDevice
from hw.simulated.illumination import SPILL_PX
from hw.simulated.picture import PictureOptics, Sensor, build_sensor
from hw.simulated.placement import look_at, resized, zoomed
from hw.simulated.simulation import calibration_between
from hw.simulated.things.stage import Hits, Solid, TurntableScene, draw_solid, pose_of, reflected

_STREAM = 300  # stream of random numbers; rooms use others
_CAMERA, _PROJECTOR = Optics(1224, 1024, 2100.0, (618.0, 508.0)), Optics(854, 480, 1500.0, (431.0, 243.0))
_AWAY, _APART = 3.4, (1.0, 1.6)  # distances over the size of the thing: of the rig from it, and between the devices
_ASIDE_DEG, _ABOVE_DEG, _NEARER = (12.0, 30.0), (22.0, 45.0), (0.85, 1.1)  # of further devices of a network
_CAMERA_STREAM, _PROJECTOR_STREAM = 4, 5
_SAMPLES = 2
_KEPT = 4  # of the last solids, because each station asks for its own anew


@dataclass(frozen=True, eq=False)
class ThingTruth:
    """`solid` in its own frame, and the camera in it: X_thing = rotation X_camera + translation of `place`."""

    solid: Solid
    place: Pose


@dataclass(frozen=True, eq=False)
class ThingRenderer:
    """Linear maps to the brightness of the camera's pixels.

    `direct_light`: from the projector's fine image. `room_light` (H, W): ambient light as bright as the projector's
    white.
    """

    picture: PictureOptics
    direct_light: sparse.csr_array
    room_light: Light

    def projected(self, light: Light) -> Light:
        """Brightness (H, W) by linear light (H, W) of the projector. Surfaces do not light each other."""
        return (self.direct_light @ self.picture.blurred(light)).reshape(self.room_light.shape)


@dataclass(frozen=True)
class Devices:
    """Camera and projector with their poses in the world."""

    camera: PlacedDevice
    projector: PlacedDevice


class SimulatedThing:
    """The thing of a seed at step `settings.pose`, in front of a rig that does not move."""

    def __init__(
        self, settings: SimulatedRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
    ) -> None:
        self.settings = settings
        seed = (settings.seed, _STREAM)
        self.solid = _solid(settings.thing, seed)
        self.room = _devices(settings, np.random.default_rng([*seed, 3]), camera_size, projector_size)
        self.pose = pose_of(self.solid, settings.thing, settings.pose, seed)
        self.stage = TurntableScene(self.solid, self.pose, settings.thing)

    @property
    def calibration(self) -> Calibration:
        """The true calibration, in metres."""
        return calibration_between(self.room.camera, self.room.projector)

    @property
    def truth(self) -> ThingTruth:
        """The shape of the thing and the pose of the camera in its frame."""
        return ThingTruth(self.solid, self.pose.inverse() @ self.room.camera.pose)

    @cached_property
    def renderer(self) -> ThingRenderer:
        """The view, by a grid of rays in each camera pixel."""
        picture = PictureOptics(
            self.room.projector.optics.width,
            self.room.projector.optics.height,
            self.settings.gamma,
            self.settings.contrast,
            self.settings.projector_blur_px,
        ).under(self.settings)
        optics = self.room.camera.optics
        x, y = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
        offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        direct, dim = sparse.csr_array((x.size, picture.fine_count), dtype=np.float32), np.zeros(x.size)
        for across in offsets:
            for down in offsets:
                hits, pixels, irradiance, gain = self._traced((x + across).ravel(), (y + down).ravel())
                lit = np.flatnonzero(irradiance)
                texels, weights = picture.interpolate(pixels[:, lit])
                weights *= (gain[lit] * irradiance[lit] / _SAMPLES**2)[:, None]
                direct = direct + sparse_matrix(lit, texels, weights, (x.size, picture.fine_count))
                dim += np.where(hits.there, hits.albedo, 0.0) / _SAMPLES**2
        white: Floats = np.asarray(direct.sum(axis=1), np.float64).ravel()
        both = (white > 0) & (dim > 0)
        level = float(np.median(white[both]) / np.median(dim[both]))
        ambient = (level * dim).astype(np.float32).reshape(x.shape)
        return ThingRenderer(picture, sparse.csr_array(direct), ambient)

    @cached_property
    def sensor(self) -> Sensor:
        """The sensor, exposed for a white picture."""
        optics = self.room.projector.optics
        white = self.renderer.picture.linear(np.full((optics.height, optics.width), 255, np.uint8))
        return build_sensor(
            self.settings, self.renderer.projected(white) + np.float32(self.settings.ambient) * self.renderer.room_light
        )

    def at(self, frame: int) -> ThingRenderer:
        """The view in a frame; nothing moves during a capture."""
        del frame
        return self.renderer

    def ambient_level(self, frame: int) -> float:
        """Ambient light in a frame, relative to the projector's white."""
        del frame
        return self.settings.ambient

    def seen(self) -> tuple[Floats, Floats, Bools]:
        """Ground truth at the centre of each camera pixel.

        The projector pixel that lights it directly (H, W, 2), NaN where none does; its brightness under a white picture
        (H, W); and whether it shows the thing (H, W).
        """
        optics = self.room.camera.optics
        shape = (optics.height, optics.width)
        x, y = np.meshgrid(np.arange(optics.width), np.arange(optics.height))
        hits, pixels, irradiance, gain = self._traced(x.ravel().astype(np.float64), y.ravel().astype(np.float64))
        inside = (irradiance > 0) & self.room.projector.optics.sees(pixels)
        bright = (gain * irradiance).reshape(shape)
        lit_by: Floats = np.where(inside, pixels, np.nan).T.reshape(*shape, 2)
        return lit_by, bright, hits.thing.reshape(shape)

    def _traced(self, x: Floats, y: Floats) -> tuple[Hits, Floats, Floats, Floats]:
        """Hits of the rays of camera pixels (n,); the projector pixels there (2, n), irradiance and gain (n,)."""
        camera, projector = self.room.camera, self.room.projector
        hits = self.stage.cast(camera.centre, camera.rays(np.stack([x, y]).astype(np.float64)).T)
        pixels, depths = projector.project(hits.points.T)
        to_light = projector.centre - hits.points
        facing = np.sum(hits.normals * to_light, axis=1)
        possible = np.flatnonzero(hits.there & (facing > 0) & projector.optics.sees(pixels, SPILL_PX))
        reached = possible[self.stage.lit(hits.points[possible], projector)]
        irradiance = np.zeros(len(x))
        irradiance[reached] = facing[reached] / depths[reached] ** 3
        gain = reflected(hits, _unit(camera.centre - hits.points), _unit(to_light), self.settings.thing.gloss)
        return hits, pixels, irradiance, gain


def _unit(vectors: Floats) -> Floats:
    directions: Floats = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return directions


def _solid(settings: ThingSettings, seed: tuple[int, int]) -> Solid:
    """The thing of a seed; a file is read anew, for it may have changed."""
    return (_draw if settings.kind == "file" else _draw_once)(settings, seed)


def _draw(settings: ThingSettings, seed: tuple[int, int]) -> Solid:
    return draw_solid(settings, np.random.default_rng([*seed, 2]))


_draw_once = lru_cache(_KEPT)(_draw)


def _devices(
    settings: SimulatedRigSettings,
    rng: np.random.Generator,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
) -> Devices:
    """Both devices in front of the table, looking down on the thing, far enough away to see all of it."""
    size = settings.thing.size_m
    target = np.array([0.0, 0.0, 0.4 * size])
    height, across = np.radians(rng.uniform(22, 38)), rng.uniform(-0.2, 0.2)
    centre = target + _AWAY * size * np.array([np.sin(across), -np.cos(across) * np.cos(height), np.sin(height)])
    side = np.array([rng.choice([-1.0, 1.0]), 0.0, rng.uniform(-0.2, 0.3)]) * rng.uniform(*_APART) * size
    lenses = settings.distortion * rng.uniform((-0.06, -0.02), (0.0, 0.02))
    placed = []
    for optics, at, image, k1 in (
        (_CAMERA, centre, camera_size, lenses[0]),
        (_PROJECTOR, centre + side, projector_size, lenses[1]),
    ):
        lens = Optics(optics.width, optics.height, optics.focal_px, optics.principal_point_px, float(k1))
        rotation = look_at(at, target, np.array([0.0, 0.0, 1.0]), float(rng.uniform(-4, 4)))
        placed.append(PlacedDevice(resized(lens, *image), rotation, at))
    camera, projector = placed
    thing, seed = settings.thing, (settings.seed, _STREAM)
    if thing.camera_place:
        camera = _elsewhere(camera, target, thing.camera_place, np.random.default_rng([*seed, _CAMERA_STREAM]))
    if thing.projector_place:
        beyond = np.random.default_rng([*seed, _PROJECTOR_STREAM])
        projector = _elsewhere(projector, target, thing.projector_place, beyond)
    return Devices(camera, projector)


def _elsewhere(device: PlacedDevice, target: Floats, place: int, rng: np.random.Generator) -> PlacedDevice:
    """A device of a network in one of its further places: aside, at another height, with another lens."""
    x, y, z = device.centre - target
    for number in range(1, place + 1):
        across = np.arctan2(y, x) + rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(*_ASIDE_DEG)) * ((number + 1) // 2)
        above, away = np.radians(rng.uniform(*_ABOVE_DEG)), rng.uniform(*_NEARER) * np.linalg.norm([x, y, z])
        k1, roll_deg = rng.uniform(-0.05, 0.03), float(rng.uniform(-12, 12))
    centre = target + away * np.array([np.cos(above) * np.cos(across), np.cos(above) * np.sin(across), np.sin(above)])
    optics = replace(device.optics, k1=float(k1) if device.optics.k1 else 0.0)
    rotation = look_at(centre, target, np.array([0.0, 0.0, 1.0]), roll_deg)
    return zoomed(PlacedDevice(optics, rotation, centre), place)
