"""The pose of a thing at each step, its surroundings, and their intersections with rays. Open3D (Embree) casts the
rays.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.deferred_imports import open3d
from calib.geometry import Pose
from calib.numerics import Bools, Floats, Ints
from hw.settings import ThingSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.things.solids import Solid

_TIPPED_EVERY = 3  # steps
_PLATE_M, _PLATE_OF_SIZE, _PLATE_CORNERS = 0.004, 0.8, 96
_OFF_CENTRE = 0.08  # distance of the thing from the axis, over its size
_ELSEWHERE = 0.15  # largest displacement over the size, when the thing is moved by hand
_BEHIND, _WIDE = 1.3, 6.0  # distance of the wall behind the axis, and half the width of the table, over the size
_SPECKLE = 25.0  # cells of the background's print per size
_GLOSS_EXPONENT = 30.0
_START = 1e-5  # distance of a ray's start from its surface, over the length of the ray
_THING, _PLATE, _BACKGROUND = 0, 1, 2


def pose_of(solid: Solid, settings: ThingSettings, step: int, seed: tuple[int, int]) -> Pose:
    """The pose of the thing at a step: X_world = R X_thing + t."""
    rng = np.random.default_rng([*seed, 0])
    aside = _OFF_CENTRE * settings.size_m * rng.standard_normal(2)
    if settings.turntable:
        turn = float(settings.step_deg or 360.0 / settings.steps) * step
        turned = np.asarray(Rotation.from_euler("z", turn, degrees=True).as_matrix(), np.float64)
        is_tipped = step % _TIPPED_EVERY == _TIPPED_EVERY - 1
        tip = np.asarray(Rotation.from_euler("x", is_tipped * settings.tip_deg, degrees=True).as_matrix(), np.float64)
        height = _PLATE_M - float((solid.vertices @ (tip @ turned).T)[:, 2].min())
        return Pose(tip @ turned, turned @ np.array([*aside, height]))
    own = np.random.default_rng([*seed, 1, step])
    rotation = np.asarray(Rotation.random(random_state=own).as_matrix(), np.float64)
    aside = aside + _ELSEWHERE * settings.size_m * own.uniform(-1, 1, 2)
    return Pose(rotation, np.array([*aside, _PLATE_M - float((solid.vertices @ rotation.T)[:, 2].min())]))


@dataclass(frozen=True, eq=False)
class Hits:
    """What n rays hit, if anything: `there` (n,).

    `points`, `normals` (n, 3) in the world, `albedo` (n,); `thing` (n,): whether it is the thing.
    """

    there: Bools
    points: Floats
    normals: Floats
    albedo: Floats
    thing: Bools


class TurntableScene:
    """A thing in a pose, with the plate of the turntable and the static background."""

    def __init__(self, solid: Solid, place: Pose, settings: ThingSettings) -> None:
        self._o3d = open3d()
        self._solid, self._size = solid, settings.size_m
        self._scene: Any = self._o3d.t.geometry.RaycastingScene(nthreads=0)
        parts = [(place @ solid.vertices, solid.triangles)]
        if settings.background:
            parts += [_plate(self._size), _surroundings(self._size)]
        for vertices, triangles in parts:
            self._scene.add_triangles(
                self._o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
                self._o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
            )

    def cast(self, origin: Floats, directions: Floats) -> Hits:
        """Cast rays (n, 3) from one origin (3,)."""
        rays = np.concatenate([np.broadcast_to(origin, directions.shape), directions], axis=1)
        hits = self._scene.cast_rays(self._o3d.core.Tensor(rays.astype(np.float32)))
        along, which = hits["t_hit"].numpy().astype(np.float64), hits["geometry_ids"].numpy()
        there = np.isfinite(along)
        points = origin + np.where(there, along, 0.0)[:, None] * directions
        normals = hits["primitive_normals"].numpy().astype(np.float64)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        normals *= -np.sign(np.sum(normals * directions, axis=1, keepdims=True))
        thing = there & (which == _THING)
        albedo = np.full(len(points), 0.5)
        resting = there & (which == _BACKGROUND)
        albedo[resting] = _speckled(points[resting] / self._size)
        corners = self._solid.triangles[hits["primitive_ids"].numpy()[thing].astype(np.int64)]
        u, v = hits["primitive_uvs"].numpy()[thing].astype(np.float64).T
        albedo[thing] = np.sum(self._solid.albedo[corners] * np.stack([1 - u - v, u, v], axis=1), axis=1)
        return Hits(there, points, normals, albedo, thing)

    def lit(self, points: Floats, light: PlacedDevice) -> Bools:
        """Which points (n, 3) nothing occludes from a device, (n,)."""
        towards = light.centre - points
        rays = np.concatenate([points + 100 * _START * towards, (1 - 200 * _START) * towards], axis=1)
        hidden = self._scene.test_occlusions(self._o3d.core.Tensor(rays.astype(np.float32)), tfar=1.0)
        return ~np.asarray(hidden.numpy(), np.bool_)


def reflected(hits: Hits, to_eye: Floats, to_light: Floats, gloss: float) -> Floats:
    """Gain (n,) from irradiance to brightness: Lambert's law, and on the thing a Phong lobe around the mirror
    direction.
    """
    if gloss == 0:
        return hits.albedo
    facing = np.sum(hits.normals * to_light, axis=1, keepdims=True)
    mirrored = 2 * facing * hits.normals - to_light
    along = np.clip(np.sum(mirrored * to_eye, axis=1), 0.0, 1.0)
    return hits.albedo + np.where(hits.thing, gloss * along**_GLOSS_EXPONENT, 0.0)


def _plate(size: float) -> tuple[Floats, Ints]:
    """The plate of the turntable: a disc and its rim."""
    around = np.linspace(0, 2 * np.pi, _PLATE_CORNERS, endpoint=False)
    ring = _PLATE_OF_SIZE * size * np.stack([np.cos(around), np.sin(around)], axis=1)
    top, foot = (np.column_stack([ring, np.full(len(ring), z)]) for z in (_PLATE_M * 0.99, 0.0))
    n = len(ring)
    here, beyond = np.arange(n), (np.arange(n) + 1) % n
    middle = np.full(n, 2 * n)
    triangles = np.concatenate(
        [
            np.stack([middle, here, beyond], axis=1),
            np.stack([here, here + n, beyond], axis=1),
            np.stack([beyond, here + n, beyond + n], axis=1),
        ]
    )
    return np.concatenate([top, foot, [[0.0, 0.0, _PLATE_M * 0.99]]]), triangles


def _surroundings(size: float) -> tuple[Floats, Ints]:
    """The table, and a wall behind it. The rig is at negative y."""
    wide, behind = _WIDE * size, _BEHIND * size
    floor = [[-wide, -wide, 0.0], [wide, -wide, 0.0], [wide, behind, 0.0], [-wide, behind, 0.0]]
    wall = [[-wide, behind, 0.0], [wide, behind, 0.0], [wide, 1.1 * behind, wide], [-wide, 1.1 * behind, wide]]
    return np.array(floor + wall), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])


def _speckled(points: Floats) -> Floats:
    """Albedo (n,) of a printed cloth at points (n, 3), in units of the size of the thing."""
    cell = np.floor(_SPECKLE * points + 0.5).astype(np.int64)
    mixed = (cell[:, 0] * 73_856_093) ^ (cell[:, 1] * 19_349_663) ^ (cell[:, 2] * 83_492_791)
    return 0.35 + 0.3 * ((mixed % 997) / 997.0)
