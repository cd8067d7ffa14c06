"""Shapes of things as triangles: superquadrics with added waves, which no model of a solver fits; or a mesh file.

Barr, "Superquadrics and angle-preserving transformations", 1981.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from calib.deferred_imports import open3d
from calib.numerics import Floats, Ints
from hw.errors import DeviceError
from hw.settings import ThingSettings

_SUBDIVISIONS = 6  # 40,962 vertices; edges are about a hundredth of the size
_WAVES = ((3.0, 0.05), (7.0, 0.02), (15.0, 0.006))  # radians per unit of the direction, and amplitude
_WAVES_EACH = 6
_SEEDS_OF_PATCHES = 80
_PLAIN, _DARK, _SHARE_DARK = 0.6, 0.06, 0.08


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
