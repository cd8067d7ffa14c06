"""Nodes on the surfaces of a scene, between which indirect light is interpolated.

*Solving* nodes cover every surface with graded spacing and exchange light. *Crease* nodes are closely spaced, in strips
along the lit creases of the corner, where the light from the neighbouring face varies as fast as the picture. Crease
nodes receive light and send none. A whole room has no crease nodes; its solving nodes are closer along every crease.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Ints
from hw.simulated.arrays import Indices
from hw.simulated.illumination import ProjectorLight
from hw.simulated.scene import Scene

_CREASE_WIDTH_M = 0.06
_ACROSS_CREASE_M = np.array([0.0, 0.003, 0.008, 0.015, 0.025, 0.04, _CREASE_WIDTH_M])
_BEYOND_LIGHT_M = 0.15
_WALL_M = 2.0  # a surface with a longer side is a wall
_ALONG_CREASE_PX = 2.0  # spacing in projector pixels; the finest fringes in use have 6


@dataclass(frozen=True)
class Chart:
    """A grid of nodes on one surface: all pairs of `u` and `v` (ascending, metres).

    Nodes are numbered from `start`, u fastest.
    """

    surface: int
    u: Floats
    v: Floats
    start: int

    @property
    def count(self) -> int:
        """The number of nodes."""
        return self.u.size * self.v.size

    def interpolate(self, uv: Floats) -> tuple[Indices, Floats]:
        """The four nodes around each point (2, n) and their bilinear weights: (n, 4) and (n, 4)."""
        column, right = _cell(self.u, uv[0])
        row, up = _cell(self.v, uv[1])
        first = self.start + row * self.u.size + column
        nodes = np.stack([first, first + 1, first + self.u.size, first + self.u.size + 1], axis=1)
        left, down = 1 - right, 1 - up
        return nodes, np.stack([left * down, right * down, left * up, right * up], axis=1)

    def support(self) -> Floats:
        """The rectangle that each node represents: (count, 2, 2), corner × (u, v)."""
        (u0, u1), (v0, v1) = _halfway(self.u), _halfway(self.v)
        low = np.stack(np.meshgrid(u0, v0), axis=-1).reshape(-1, 2)
        high = np.stack(np.meshgrid(u1, v1), axis=-1).reshape(-1, 2)
        return np.stack([low, high], axis=1)


@dataclass(frozen=True)
class RadiosityMesh:
    """One solving chart per surface, in the order of the surfaces, and the crease charts."""

    solving: tuple[Chart, ...]
    creases: tuple[Chart, ...]

    @property
    def solving_count(self) -> int:
        """The number of nodes that exchange light; they are numbered first."""
        return sum(chart.count for chart in self.solving)

    @property
    def count(self) -> int:
        """The number of all nodes."""
        return self.solving_count + sum(chart.count for chart in self.creases)

    def interpolate_solving(self, surface: Ints, uv: Floats) -> tuple[Indices, Floats]:
        """Solving nodes (n, 4) and weights (n, 4) for points (2, n) on surfaces (n,)."""
        return _interpolate(self.solving, surface, uv)

    def interpolate(self, surface: Ints, uv: Floats) -> tuple[Indices, Floats]:
        """The finest nodes (n, 4) and weights (n, 4) for points (2, n) on surfaces (n,)."""
        nodes, weights = _interpolate(self.solving, surface, uv)
        for chart in self.creases:
            within = (surface == chart.surface) & (uv[0] < chart.u[-1]) & (uv[1] < chart.v[-1])
            here = np.flatnonzero(within & (uv[0] >= chart.u[0]) & (uv[1] >= chart.v[0]))
            nodes[here], weights[here] = chart.interpolate(uv[:, here])
        return nodes, weights


def build_mesh(light: ProjectorLight) -> RadiosityMesh:
    """Nodes for a scene, closely spaced along the creases that the projector lights."""
    scene = light.scene
    solving: list[Chart] = []
    for surface in range(scene.surface_count):
        u, v = (_lines(scene, surface, float(size)) for size in scene.sizes[surface])
        solving.append(Chart(surface, u, v, sum(chart.count for chart in solving)))
    creases: list[Chart] = []
    start = sum(chart.count for chart in solving)
    for surface, u, v in () if scene.all_round else _crease_lines(light):
        creases.append(Chart(surface, u, v, start))
        start += creases[-1].count
    return RadiosityMesh(tuple(solving), tuple(creases))


def _lines(scene: Scene, surface: int, size: float) -> Floats:
    if scene.all_round and size > _WALL_M:
        return _graded_from_both_ends(size)
    if surface < 3:
        return _graded(size)
    finest, parts = (0.15, 4) if scene.all_round else (0.08, 6)
    spacing = 0.7 if surface < 6 else 0.05 if surface in scene.spheres else max(finest, size / parts)
    return np.linspace(0.0, size, max(2, round(size / spacing) + 1))


def _graded(size: float) -> Floats:
    """Grid lines 2 cm apart at a crease, 20 cm within reach of the projector, and up to 45 cm beyond."""
    lines = [0.0]
    step = 0.02
    while lines[-1] + 1.5 * step < size:
        lines.append(lines[-1] + step)
        step = min(1.3 * step, 0.2 if lines[-1] < 1.6 else 0.45)
    return np.array([*lines, size])


def _graded_from_both_ends(size: float) -> Floats:
    """Grid lines 4 cm apart at either end and up to 40 cm in the middle. A whole room has many creases."""
    half = [0.0]
    step = 0.04
    while half[-1] + 1.5 * step < size / 2:
        half.append(half[-1] + step)
        step = min(1.6 * step, 0.4)
    return np.concatenate([half, size - np.array(half[::-1])])


def _crease_lines(light: ProjectorLight) -> Iterator[tuple[int, Floats, Floats]]:
    """Two strips on each face of the corner, along its two creases."""
    reach = [_lit_length(light, axis) for axis in range(3)]
    optics = light.projector.optics
    distance = float(np.linalg.norm(light.projector.centre))
    spacing = _ALONG_CREASE_PX * distance / optics.focal_px
    for face in range(3):
        along_u, along_v = reach[(face + 1) % 3], reach[(face + 2) % 3]
        if along_v > _CREASE_WIDTH_M:
            yield face, _ACROSS_CREASE_M, np.linspace(0.0, along_v, max(2, round(along_v / spacing) + 1))
        if along_u > 2 * _CREASE_WIDTH_M:
            steps = max(2, round((along_u - _CREASE_WIDTH_M) / spacing) + 1)
            yield face, np.linspace(_CREASE_WIDTH_M, along_u, steps), _ACROSS_CREASE_M


def _lit_length(light: ProjectorLight, axis: int) -> float:
    """Length from the vertex along an edge of the corner on which the projector's light matters."""
    edge = light.scene.room.edges[axis]
    share = np.linspace(0.0, 1.0, 500)
    pixels, _ = light.projector.project(light.scene.room.origin[:, None] + edge[:, None] * share)
    lit = np.flatnonzero(light.projector.optics.sees(pixels))
    length = float(np.linalg.norm(edge))
    return min(share[lit[-1]] * length + _BEYOND_LIGHT_M, length) if lit.size else 0.0


def _interpolate(charts: tuple[Chart, ...], surface: Ints, uv: Floats) -> tuple[Indices, Floats]:
    nodes = np.empty((surface.size, 4), np.int64)
    weights = np.empty((surface.size, 4))
    order = np.argsort(surface, kind="stable")
    bounds = np.searchsorted(surface[order], np.arange(len(charts) + 1))
    for chart, start, end in zip(charts, bounds[:-1], bounds[1:], strict=True):
        here = order[start:end]
        nodes[here], weights[here] = chart.interpolate(uv[:, here])
    return nodes, weights


def _cell(lines: Floats, position: Floats) -> tuple[Indices, Floats]:
    cell = np.searchsorted(lines, position, side="right").clip(1, lines.size - 1) - 1
    fraction = (position - lines[cell]) / (lines[cell + 1] - lines[cell])
    return cell, fraction.clip(0.0, 1.0)


def _halfway(lines: Floats) -> tuple[Floats, Floats]:
    """Lower and upper ends of the interval that each grid line represents."""
    middles = (lines[1:] + lines[:-1]) / 2
    return np.append(lines[0], middles), np.append(middles, lines[-1])
