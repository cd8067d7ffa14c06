"""The pose of a thing at each step, its surroundings, and their intersections with rays. Open3D (Embree) casts the
rays.

Shapes of things as triangles: superquadrics with added waves, which no model of a solver fits; or a mesh file.

Barr, "Superquadrics and angle-preserving transformations", 1981.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.deferred_imports import open3d
from calib.geometry import Pose
from calib.numerics import Bools, Floats, Ints
from hw.errors import DeviceError
from hw.settings import ThingSettings
from hw.simulated.device import PlacedDevice

_SUBDIVISIONS = 6  # 40,962 vertices; edges are about a hundredth of the size
_WAVES = ((3.0, 0.05), (7.0, 0.02), (15.0, 0.006))  # radians per unit of the direction, and amplitude
_WAVES_EACH = 6
_SEEDS_OF_PATCHES = 80
_PLAIN, _DARK, _SHARE_DARK = 0.6, 0.06, 0.08
_TIPPED_EVERY = 3  # steps
_PLATE_M, _PLATE_OF_SIZE, _PLATE_CORNERS = 0.004, 0.8, 96
_OFF_CENTRE = 0.08  # distance of the thing from the axis, over its size
_ELSEWHERE = 0.15  # largest displacement over the size, when the thing is moved by hand
_BEHIND, _WIDE = 1.3, 6.0  # distance of the wall behind the axis, and half the width of the table, over the size
_SPECKLE = 25.0  # cells of the background's print per size
_GLOSS_EXPONENT = 30.0
_START = 1e-5  # distance of a ray's start from its surface, over the length of the ray
_THING, _PLATE, _BACKGROUND = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Solid:
    """`vertices` (V, 3) in metres about the centre, outward `triangles` (T, 3), `albedo` (V,)."""

    vertices: Floats
    triangles: Ints
    albedo: Floats

    @property
    def volume(self) -> float:
        """Volume of a closed surface in cubic metres, by the divergence theorem."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return float(np.sum(a * np.cross(b, c)) / 6)

    @property
    def area(self) -> float:
        """Surface area in square metres."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return float(np.sum(np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2)


def draw_solid(settings: ThingSettings, rng: np.random.Generator) -> Solid:
    """The thing of the settings. Raises DeviceError for a file that cannot be read."""
    if settings.kind == "file":
        vertices, triangles = _read(settings)
    else:
        ways, triangles = _icosphere()
        vertices = ways * _radius(ways, settings.kind, rng)[:, None]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2) * (settings.size_m / float(np.max(high - low)))
    return Solid(vertices, triangles, _painted(vertices, settings.patches, rng))


def _radius(ways: Floats, kind: str, rng: np.random.Generator) -> Floats:
    """Radius (V,) of the surface in unit directions (V, 3), in an arbitrary unit."""
    axes, exponents = np.ones(3), np.ones(2)
    if kind == "lump":
        axes, exponents = rng.uniform(0.65, 1.0, 3), rng.uniform(0.4, 1.2, 2)
    elif kind == "box":
        axes, exponents = np.array([1.0, 0.8, 0.6]), np.array([0.15, 0.15])
    elif kind == "plate":
        axes = np.array([1.0, 1.0, 0.12])
    x, y, z = np.abs(ways / axes).T
    first, second = exponents
    radius: Floats = ((x ** (2 / second) + y ** (2 / second)) ** (second / first) + z ** (2 / first)) ** (-first / 2)
    if kind == "vase":
        return radius * (0.75 + 0.2 * np.sin(5 * ways[:, 2] + 0.5))
    if kind != "lump":
        return radius
    bumps = np.zeros(len(ways))
    for frequency, amplitude in _WAVES:
        for wave in frequency * rng.standard_normal((_WAVES_EACH, 3)):
            bumps += amplitude / np.sqrt(_WAVES_EACH / 2) * np.sin(ways @ wave + rng.uniform(0, 2 * np.pi))
    return radius * (1 + bumps)


def _painted(vertices: Floats, contrast: float, rng: np.random.Generator) -> Floats:
    """Patches of constant albedo, some of them nearly black, (V,)."""
    seeds = vertices[rng.integers(len(vertices), size=_SEEDS_OF_PATCHES)]
    drawn = np.where(rng.random(_SEEDS_OF_PATCHES) < _SHARE_DARK, _DARK, rng.uniform(0.3, 0.85, _SEEDS_OF_PATCHES))
    nearest = np.argmin(np.sum((vertices[:, None] - seeds) ** 2, axis=2), axis=1)
    albedo: Floats = _PLAIN + contrast * (drawn[nearest] - _PLAIN)
    return albedo


@cache
def _icosphere() -> tuple[Floats, Ints]:
    """Unit directions (V, 3), and outward triangles (T, 3)."""
    golden = (1 + 5**0.5) / 2
    corners = [(0.0, a, b) for a in (-1.0, 1.0) for b in (-golden, golden)]
    vertices = np.array([np.roll(corner, turn) for turn in range(3) for corner in corners])
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=2)
    near = (apart < 2.1) & (apart > 0)
    triangles = np.array(
        [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]]
    )
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    inward = np.sum(a * np.cross(b, c), axis=1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    for _ in range(_SUBDIVISIONS):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, number = np.unique(edges, axis=0, return_inverse=True)
        between = len(vertices) + number.reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[unique].mean(axis=1)])
        (a, b, c), (ab, bc, ca) = triangles.T, between.T
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), triangles


def _read(settings: ThingSettings) -> tuple[Floats, Ints]:
    path = Path(settings.file or "")
    mesh = open3d().io.read_triangle_mesh(str(path)) if path.is_file() else None
    if mesh is None or len(mesh.triangles) == 0:
        raise DeviceError(f"rig.thing.file: expected a mesh (PLY, OBJ, STL, OFF), found none in '{path}'")
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.triangles, np.int64)


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
